"""Measures of a record: readings that stand still, repeat or are out of proportion, and unknown commands."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.errors import moment
from massprop_drake.inputs import factors
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.inputs.vehicle_sensors import Accelerometer, SensorPackage
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.mass_properties import CENTER_OF_MASS, ELEMENT, MASS_RECIPROCAL

STUCK = 10.0  # quanta or 1-sigma that a reading must be predicted to change by before standing still counts
FEWEST = 10  # samples that tell the unit
UNIT_LIMIT = 2.5  # factor between measured and predicted that is called wrong; feet to meters is 3.28
_NET = 0.25  # of the sum of what each jet alone should change it by: less cancels where thrusts are a quarter off
_AGAINST_S = 5.0  # for which jets may fire against one that has failed, and nothing changes
ANSWERED = 0.5  # share of what is predicted that the other readings must show, or the jets have not fired
_MOST_UNKNOWN = 100  # stretches of unknown commands that are kept
_MOST_JETS = 2  # that are blamed for readings that do not follow; more, and the readings are wrong


class Package(NamedTuple):
    """A sensor package, and the readings expected of it on the nominal vehicle.

    Attributes:
        package: as the vehicle file has it.
        scale: quantum or 1-sigma of a reading, whichever is larger.
        increment_std: 1-sigma of an increment.
        each: size of the increments that each jet could cause in one sample, shape (n_jets, 3).
        by_turning: size of what the vehicle's own rate could change a component by in one sample, over its square, s or
            ft s or m s: dynamic coupling, and what turns the place of an accelerometer about the center of mass.
    """

    package: SensorPackage
    scale: float
    increment_std: float
    each: Array
    by_turning: float


class _Body(NamedTuple):
    """Mass properties of a rigid body, from which increments of readings are predicted.

    Attributes:
        inverse: inverse inertia, shape (3, 3).
        center: of mass, shape (3,).
        lightness: mass reciprocal.
    """

    inverse: Array
    center: Array
    lightness: float

    def predict_increments(self, impulses: Array, package: SensorPackage) -> Array:
        """Predicts increments of a package's readings, shape (n, 3), by impulses about the origin, shape (n, 6)."""
        turned: Array = (impulses[:, :3] - np.cross(self.center, impulses[:, 3:])) @ self.inverse
        if not isinstance(package, Accelerometer):
            return turned
        return impulses[:, 3:] * self.lightness + np.cross(turned, np.array(package.position) - self.center)


def rigid_body(parameters: Array) -> _Body:
    """Makes a rigid body from the ten estimated parameters: inverse inertia, center of mass, 1/mass; shape (10,)."""
    return _Body(parameters[ELEMENT], parameters[CENTER_OF_MASS], float(parameters[MASS_RECIPROCAL]))


class Stuck(NamedTuple):
    """Stretch in which a reading stood still.

    Attributes:
        entry: as the summary has it.
        package: it is of.
        axis: of it.
        impulse: between where the predicted change was least and where it was most, torque about the origin first,
            shape (6,).
    """

    entry: dict[str, Any]
    package: Package
    axis: int
    impulse: Array

    @property
    def lasted_s(self) -> float:
        """Duration of the stretch without change, s."""
        return float(self.entry["to_s"] - self.entry["from_s"])

    def is_real(self, failed_s: float) -> bool:
        """Tests whether the stretch ended before a jet failed, or is too long for jets that fire against that one."""
        return bool(self.entry["to_s"] <= failed_s or self.lasted_s > _AGAINST_S)


class Ratio(NamedTuple):
    """Ratio of a reading's change in a sample over the predicted change.

    Attributes:
        ratio: of both.
        time_s: of the sample.
        fired: jets that were told to fire, shape (n_jets,).
        turned: what the vehicle's turn may have changed the reading by, in what was predicted.
    """

    ratio: float
    time_s: float
    fired: Array
    turned: float


class Standing:
    """State of the search for stuck readings, by component: stretch without change, and change predicted in it."""

    def __init__(self) -> None:
        self.value = np.full(3, np.nan)
        self.since_s = np.full(3, np.nan)
        self.until_s = np.full(3, np.nan)
        self.sum = np.zeros(3)
        self.least = np.zeros(3)
        self.most = np.zeros(3)
        self.at = np.zeros((3, 2, 6))  # impulses gathered since the beginning where that change was least and most
        self.sure = [False] * 3  # whether that change could not be what jets against each other leave
        self.gross = np.zeros(3)  # of what each jet alone should change it by, gathered since the beginning
        self.gross_since = np.zeros(3)  # at its first sample
        self.answer = np.zeros((3, 2))  # of the other readings, gathered since the beginning, see `Answer`
        self.answer_since = np.zeros((3, 2))  # at its first sample
        self.fired_since = np.zeros((3, 1))  # samples with each jet told to fire and nothing shown, likewise


class Repeats:
    """Repeats of a package's reading, all three components, where the jets should have changed it."""

    def __init__(self) -> None:
        self.count = self.of = 0
        self.times = 0  # that it began to
        self.changed = False  # whether the newest reading was another one than that before

    def add(self, increments: Array, should_change: NDArray[np.bool_]) -> None:
        """Counts the samples of a block in which a reading repeats though jets should have changed it.

        Args:
            increments: of the reading, NaN where one is missing, shape (n, 3).
            should_change: whether it should have changed by much, shape (n,).
        """
        repeats = (increments == 0.0).all(axis=1)
        changed = ~repeats & ~np.isnan(increments).any(axis=1)
        before = np.concatenate([[self.changed], changed[:-1]])
        self.count += int((should_change & repeats).sum())
        self.of += int((should_change & (repeats | changed)).sum())
        self.times += int((should_change & repeats & before).sum())
        self.changed = bool(changed[-1])


class Answer(NamedTuple):
    """Agreement of all increments with their predictions, sample by sample, in 1-sigma of an increment.

    Attributes:
        own: increment times predicted, and the square of the latter, of each component of each package, by its name,
            shape (n, 3, 2).
        fired: jets told to fire, where they count, shape (n, n_jets).
    """

    own: Mapping[str, Array]
    fired: Array

    @property
    def total(self) -> Array:
        """Sums over all components: measured times predicted, and predicted squared, shape (n, 2)."""
        nothing = np.zeros((self.fired.shape[0], 2))  # a vehicle may have no package in body axes
        result: Array = sum((part.sum(axis=1) for part in self.own.values()), start=nothing)
        return result

    @property
    def silent(self) -> Array:
        """Mask of jets commanded in samples whose readings do not show the predicted change, shape (n, n_jets)."""
        measured, predicted = self.total.T
        result: Array = self.fired * (measured < ANSWERED * predicted)[:, None]
        return result

    def total_of_others(self, name: str, axis: int) -> Array:
        """Computes `total` without one component, weighted by that one's share of the prediction, shape (n, 2)."""
        total, component = self.total, self.own[name][:, axis]
        share = np.divide(component[:, 1], total[:, 1], out=np.zeros(len(component)), where=total[:, 1] > 0.0)
        result: Array = share[:, None] * (total - component)
        return result


def is_significant_change(net: Array, gross: Array, extremes: tuple[float, float], entry: Package) -> bool:
    """Tests whether a predicted change exceeds noise, and the residue of jets that cancel, at some sample.

    Args:
        net: change since the beginning, shape (n,).
        gross: what each jet alone should have changed the reading by, gathered, shape (n,).
        extremes: most and least change before these samples, see `_NOTHING`.
        entry: whose reading it is.
    """
    highest, lowest = np.maximum.accumulate(net), np.minimum.accumulate(net)
    change = np.maximum(highest, extremes[0]) - np.minimum(lowest, extremes[1])
    return bool(((change >= STUCK * entry.scale) & (change >= _NET * gross)).any())


def impulses_at_extremes(change: Array, impulses: Array, extremes: tuple[float, float], earlier: Array) -> Array:
    """Returns summed impulses where a stretch's predicted change was least and where most, shape (2, 6).

    Args:
        change: change since the beginning, shape (n,).
        impulses: impulses likewise, shape (n, 6).
        extremes: most and least change before these samples, see `_NOTHING`.
        earlier: the impulses there, least first, shape (2, 6).
    """
    result: Array = impulses[[int(change.argmin()), int(change.argmax())]]
    most, least = extremes
    result[0] = earlier[0] if least < change.min() else result[0]
    result[1] = earlier[1] if most > change.max() else result[1]
    return result


def could_be_off_nominal(slope: float) -> bool:
    """Tests whether a ratio of measured to predicted change is 1/2.5 to 2.5, as off-nominal mass explains."""
    return 1.0 / UNIT_LIMIT <= slope <= UNIT_LIMIT


def jets_to_blame(ratios: Array, fired: NDArray[np.bool_]) -> list[int]:
    """Returns indices of the fewest jets without whose firings readings change as predicted; empty: none.

    Wrong units are wrong whichever jets fire; a jet that fails is so only while it is told to.
    """
    left, blamed = np.ones(ratios.size, dtype=bool), []
    for _ in range(_MOST_JETS):
        wrong = ~((ratios >= 1.0 / UNIT_LIMIT) & (ratios <= UNIT_LIMIT))
        balance = [int((left & wrong & jet).sum()) - int((left & ~wrong & jet).sum()) for jet in fired.T]
        blamed.append(int(np.argmax(balance)))
        left &= ~fired[:, blamed[-1]]
        if left.sum() >= FEWEST and could_be_off_nominal(float(np.median(ratios[left]))):
            return blamed
    return []


def likely_cause(slope: float, known: Sequence[factors.Factor]) -> str:
    """Returns words for a message on the likely cause of a scale factor, as a unit or a sign; "": not known."""
    if slope <= 0.0:
        return "; it looks like a wrong sign or wrong axes"
    near = factors.factors_near(slope, known)
    return f"; it looks like {near[0].name}" if near else ""


def format_stretch(entry: dict[str, Any]) -> str:
    """Formats a stretch of time as text, such as "from 1 to 2 s"."""
    return f"from {moment(entry['from_s'])} to {moment(entry['to_s'])} s"


class UnknownCommands:
    """Collection of stretches with unknown commands, block by block.

    Attributes:
        count: number of stretches.
        samples: number of samples that are in one.
        until_s: end of the record.
    """

    def __init__(self, vehicle: Vehicle):
        self._vehicle, self._stretches = vehicle, list[dict[str, Any]]()
        self._within = False  # whether the last sample is in one
        self.count, self.samples, self.until_s = 0, 0, -math.inf

    def add(self, time_s: Array, unknown: NDArray[np.bool_], recorded: NDArray[np.bool_]) -> None:
        """Counts the samples of a block with unknown commands, and joins them into stretches.

        Args:
            time_s: their ends, s, shape (n,).
            unknown: whose command is not known, shape (n, n_jets).
            recorded: rows that there are, shape (n,).
        """
        self.until_s = float(time_s[-1]) if time_s.size else self.until_s
        any_unknown = unknown.any(axis=1) & recorded
        in_stretch = np.append(self._within, any_unknown)
        self._within = bool(in_stretch[-1])
        for row in np.flatnonzero(any_unknown).tolist():
            self._note_sample(float(time_s[row]), np.flatnonzero(unknown[row]), new_stretch=not in_stretch[row])

    def _note_sample(self, time_s: float, jets: NDArray[np.int_], *, new_stretch: bool) -> None:
        """Counts a sample of unknown commands, and begins a stretch or extends the last one."""
        self.samples += 1
        names = [self._vehicle.designations[jet] for jet in jets.tolist()]
        if new_stretch:
            self.count += 1
            if self.count <= _MOST_UNKNOWN:
                from_s = time_s - self._vehicle.sample_period_s
                self._stretches.append({"jets": names, "from_s": from_s, "to_s": time_s, "samples": 0})
        if self.count <= _MOST_UNKNOWN:
            last = self._stretches[-1]
            added = [name for name in names if name not in last["jets"]]
            last.update(jets=[*last["jets"], *added], to_s=time_s, samples=last["samples"] + 1)

    def first_stretches(self) -> list[dict[str, Any]]:
        """Returns the first stretches, each a dict of jets, beginning and end, s, and number of samples."""
        return self._stretches
