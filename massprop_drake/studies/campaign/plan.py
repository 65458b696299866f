"""Plan of a campaign: every drawn value of every case, before any is flown.

What is drawn for a sample depends on the campaign's seed and the sample's number alone, never on workers, order or
the number of cases, so that a campaign can grow and one case can be flown by itself.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import math
import re
import warnings
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.errors import InputError
from massprop_drake.inputs.campaign_file import MOST_CASES, CampaignSpec, settings_of, with_settings
from massprop_drake.inputs.scenario import Scenario

Array = NDArray[np.float64]

FLOWN, FAILED = "flown", "failed"  # what becomes of a case; failed: it could not be run
_DRAWS, _DESIGN = 0, 1  # streams of chance beside the cases' own: independent draws, and designs made as a whole


class PlannedCase(NamedTuple):
    """Fully resolved case.

    Attributes:
        case_id: its number; the samples of all cells come one after the other.
        sample: number of its draw; the same in every cell of the sweep.
        cell: number of its cell.
        seed: of its scenario.
        drawn: what was drawn, by the quantity's label.
        swept: what the cell has, by dotted key.
        settings: fields of the scenario that the case replaces, by dotted key.
        record: telemetry to read; None: the case is simulated.
    """

    case_id: int
    sample: int
    cell: int
    seed: int
    drawn: Mapping[str, Any]
    swept: Mapping[str, Any]
    settings: Mapping[str, Any]
    record: str | None = None

    @property
    def digest(self) -> str:
        """SHA-256 of the content of the case, hexadecimal."""
        content = [self.seed, self.settings, self.record]
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()

    def scenario(self, base: Scenario, campaign: str) -> Scenario:
        """Returns the scenario that flies the case by itself: the base with its draws, seed and name.

        Args:
            base: the campaign's.
            campaign: its name.

        Raises:
            InputError: when what was drawn makes no scenario.
        """
        settings = {**self.settings, "seed": self.seed, "name": f"{campaign}_{case_name(self.case_id)}"}
        return with_settings(base, settings)


def case_name(case_id: int) -> str:
    """Returns the name of a case's folder."""
    return f"{case_id:04d}"


def plan_cases(campaign: CampaignSpec) -> list[PlannedCase]:
    """Returns all cases of a campaign with their drawn values; checks that each can be flown.

    Raises:
        InputError: when a draw is impossible, naming the case.
    """
    file = campaign.file
    records = _find_records(campaign)
    coordinates = sample_coordinates(campaign, len(records))
    _require_few(campaign, len(coordinates) * math.prod(map(len, file.sweep.values())))
    cells = [dict(zip(file.sweep, values, strict=True)) for values in itertools.product(*file.sweep.values())]
    columns = list(_draw_values(campaign, coordinates))
    cases = []
    for sample in range(len(coordinates)):
        drawn = {quantity.label: column[sample] for quantity, column in zip(campaign.quantities, columns, strict=True)}
        settings = settings_of(campaign, drawn)
        sequence = np.random.SeedSequence(file.seed, spawn_key=(sample,))
        seed = int(sequence.generate_state(1, np.uint64)[0] >> np.uint64(1))
        for number, cell in enumerate(cells):
            case_id = sample * len(cells) + number
            record = records[sample] if records else None
            case = PlannedCase(case_id, sample, number, seed, drawn, cell, {**settings, **cell}, record)
            try:
                case.scenario(campaign.base, file.name)
            except InputError as error:
                raise InputError(
                    *(
                        f"{campaign.source}: case {case_id}: {_problem_with_draws(problem, drawn)}"
                        for problem in error.problems
                    )
                ) from None
            cases.append(case)
    return cases


def _problem_with_draws(problem: str, values: Mapping[str, Any]) -> str:
    """Returns a case's error message with the drawn values of the scenario block that it names."""
    problem = problem.removeprefix("scenario: ")
    block = re.split(r"[.\[:]", problem, maxsplit=1)[0]
    draws = [
        f"{label} = {value}" for label, value in values.items() if re.split(r"[.\[]", label, maxsplit=1)[0] == block
    ]
    return problem if not draws else f"{problem}; drawn: {', '.join(draws)}"


def _require_few(campaign: CampaignSpec, n_cases: int) -> None:
    """Checks that a campaign has at most `MOST_CASES` cases, else InputError."""
    if n_cases > MOST_CASES:
        raise InputError(f"{campaign.source}: is a campaign of {n_cases} cases; expected {MOST_CASES} at the most")


def _find_records(campaign: CampaignSpec) -> list[str]:
    """Returns paths of a campaign's telemetry records, sorted, one per case; empty for simulated cases."""
    if campaign.file.records is None:
        return []
    try:
        paths = sorted(str(path.resolve()) for path in campaign.folder.glob(campaign.file.records))
    except (NotImplementedError, ValueError):
        raise InputError(
            f"{campaign.source}: records: {campaign.file.records!r} is no pattern of files relative to this one"
        ) from None
    if not paths:
        raise InputError(f"{campaign.source}: records: no file fits {campaign.file.records!r} in {campaign.folder}")
    n_cases = campaign.file.cases
    if n_cases is not None and n_cases > len(paths):
        raise InputError(f"{campaign.source}: cases: {n_cases} are asked for, and there are {len(paths)} records")
    return paths[:n_cases]


def sample_coordinates(campaign: CampaignSpec, n_records: int = 0) -> Array:
    """Computes coordinates of all samples in the unit cube, shape (n_samples, n_quantities), by the method.

    Args:
        campaign: for method, seed, number of cases and quantities.
        n_records: number of records, when the campaign reads some.

    Raises:
        InputError: when the method cannot give that number of cases.
    """
    file, dimensions = campaign.file, len(campaign.quantities)
    count = n_records or file.cases or 0
    if file.method == "grid":
        return _grid_points(campaign)
    if dimensions == 0:
        return np.empty((count, 0))
    generator = np.random.default_rng(np.random.SeedSequence(file.seed, spawn_key=(_DESIGN, dimensions)))
    if file.method == "lhs":
        from scipy.stats import qmc  # noqa: PLC0415 (slow to load)

        return qmc.LatinHypercube(dimensions, rng=generator).random(count)
    if file.method == "sobol":
        return _sobol_points(generator, dimensions, count)
    if file.method == "saltelli":
        return _saltelli_points(campaign, generator, count)
    return np.array(
        [
            np.random.default_rng(np.random.SeedSequence(file.seed, spawn_key=(sample, _DRAWS))).random(dimensions)
            for sample in range(count)
        ]
    )


def _sobol_points(generator: np.random.Generator, dimensions: int, count: int) -> Array:
    """Draws scrambled Sobol points in the unit cube, shape (count, dimensions)."""
    from scipy.stats import qmc  # noqa: PLC0415 (slow to load)

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # `CampaignSpec.doubts` says it in our words
        return qmc.Sobol(dimensions, rng=generator).random(count)


def _saltelli_points(campaign: CampaignSpec, generator: np.random.Generator, count: int) -> Array:
    """Computes Sobol points A and B, and A with each column of B in turn, shape (n (d + 2), d)."""
    dimensions = len(campaign.quantities)
    points, remainder = divmod(count, dimensions + 2)
    if remainder or points & (points - 1) or not points:
        fitting = (dimensions + 2) * 2 ** max(0, round(np.log2(max(points, 1))))
        raise InputError(
            f"{campaign.source}: cases: saltelli needs a power of two times {dimensions + 2} (the {dimensions} "
            f"quantities and 2), such as {fitting}; got {count}"
        )
    first, second = np.hsplit(_sobol_points(generator, 2 * dimensions, points), 2)
    mixed = []
    for column in range(dimensions):
        part = first.copy()
        part[:, column] = second[:, column]
        mixed.append(part)
    return np.vstack([first, second, *mixed])


def _grid_points(campaign: CampaignSpec) -> Array:
    """Returns indices of all combinations of values, the last quantity running fastest, shape (n, n_quantities)."""
    sizes = []
    for quantity in campaign.quantities:
        values = quantity.distribution.grid()
        if values is None:
            raise InputError(
                f"{campaign.source}: draw: {quantity.label}: grid needs to know how many values to take; "
                "give points, or a choice"
            )
        sizes.append(len(values))
    count = math.prod(sizes)
    _require_few(campaign, count)
    if campaign.file.cases not in (None, count):
        raise InputError(
            f"{campaign.source}: cases: the grid has {count} of them, got {campaign.file.cases}; leave it out"
        )
    return np.stack([axis.ravel() for axis in np.indices(sizes)], axis=1).astype(float) if sizes else np.empty((1, 0))


def _draw_values(campaign: CampaignSpec, coordinates: Array) -> Iterator[list[Any]]:
    """Yields, quantity by quantity, its values in all samples."""
    for quantity, column in zip(campaign.quantities, coordinates.T, strict=True):
        values = quantity.distribution.grid() if campaign.file.method == "grid" else None
        if values is None:
            yield quantity.distribution.quantiles(column)
        else:
            yield [values[int(number)] for number in column]
