"""Content of an export, the same for every format: signals, frames, a scene and messages of a run."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.display import event_marks, motion, solids
from massprop_drake.display.plot_source import failing_jets as truly_failing
from massprop_drake.display.style import (
    ESTIMATE_COLOR,
    FAILED_COLOR,
    PAYLOAD_COLOR,
    PLUME_COLOR,
    SUSPECT_COLOR,
    TRUTH_COLOR,
    UNTOLD_COLOR,
    WITHHELD_COLOR,
)
from massprop_drake.errors import InputError, counted
from massprop_drake.maths.attitude import rotation_matrix
from massprop_drake.maths.mass_properties import CENTER_OF_MASS
from massprop_drake.results.detections import in_words as detection_in_words
from massprop_drake.results.events import in_words as event_in_words
from massprop_drake.results.spool import Spool

if TYPE_CHECKING:
    from massprop_drake.results.run_content import RunContent

Array = NDArray[np.float64]
Color = tuple[int, int, int, int]  # red, green, blue and opacity, 0 to 255

WORLD, VEHICLE, VEHICLE_ESTIMATED = "world", "vehicle", "vehicle_estimated"
CENTER, CENTER_ESTIMATED = "center_of_mass", "center_of_mass_estimated"
PARENTS = {VEHICLE: WORLD, VEHICLE_ESTIMATED: WORLD, CENTER: VEHICLE, CENTER_ESTIMATED: VEHICLE}
_POSES = {
    VEHICLE: ("position", "attitude", "truth"),
    VEHICLE_ESTIMATED: ("position_estimate", "attitude_estimate", "estimate"),
}
_ROWS = 4096  # that are held in a format's form at a time
_OPACITY = 0.35  # of the body: the centers of mass lie inside, and marks behind
_PLUMES = {"given": PLUME_COLOR, "untold": UNTOLD_COLOR, "withheld": WITHHELD_COLOR}
_MARKS = {"failed": FAILED_COLOR, "found": SUSPECT_COLOR}
_MOST_NS = 2**32 * 10**9  # of times that all formats can hold: to the year 2106


class Series(NamedTuple):
    """Logged signal.

    Attributes:
        name: as in `Run.descriptions`.
        label: the quantity, in words.
        components: names of its columns.
        units: of each column, "-" for none.
    """

    name: str
    label: str
    components: tuple[str, ...]
    units: tuple[str, ...]

    @property
    def is_mixed(self) -> bool:
        """True if its columns have several units."""
        return len(set(self.units)) > 1


class Mesh(NamedTuple):
    """Surface in the vehicle frame: triangles, ft or m, shape (n, 3, 3), and their color."""

    triangles: Array
    color: Color


class Arrows(NamedTuple):
    """Arrows in the vehicle frame: where they begin and what they span, ft or m, shape (k, 3) each, and colors."""

    origins: Array
    vectors: Array
    colors: list[Color]


class Balls(NamedTuple):
    """Ellipsoids along the vehicle's axes: centers and half axes, ft or m, shape (k, 3) each, and colors."""

    centers: Array
    half_sizes: Array
    colors: list[Color]


class LogEntry(NamedTuple):
    """Event in words.

    Attributes:
        time_s: run time, s.
        level: how much it matters.
        source: "scenario" (what truly happens), "detector", "record" or "run".
        text: the sentence.
    """

    time_s: float
    level: Literal["info", "warning", "error"]
    source: str
    text: str


class Outline(NamedTuple):
    """Constant part of a run's content.

    Attributes:
        title: scenario and vehicle.
        start_ns: time of the first row, ns.
        has_epoch: whether times are since 1970; else since the run's time zero.
        length_unit: of frames and scene.
        extent: largest dimension of the vehicle.
        series: every signal by name.
        frames: names of the frames that move, see `PARENTS`.
        jets: place and rotation (w, x, y, z) of each jet's frame in the vehicle frame by designation; z is the
            direction of its plume.
        body: surfaces of the vehicle and its nozzles.
        notes: sentences on what the run does not tell.
    """

    title: str
    start_ns: int
    has_epoch: bool
    length_unit: str
    extent: float
    series: dict[str, Series]
    frames: tuple[str, ...]
    jets: dict[str, tuple[Array, Array]]
    body: list[Mesh]
    notes: tuple[str, ...]


class SampleBlock(NamedTuple):
    """Stretch of samples.

    Attributes:
        time_ns: shape (n,).
        signals: by name, shape (n, components).
        frames: translation, shape (n, 3), and rotation (w, x, y, z), shape (n, 4), from the parent; NaN: not known.
        scene: parts of the scene by name, each with the rows in which it is another than before.
        messages: with their times, ns, in order.
    """

    time_ns: NDArray[np.int64]
    signals: Mapping[str, Array]
    frames: dict[str, tuple[Array, Array]]
    scene: dict[str, list[tuple[int, Arrows | Balls]]]
    messages: list[tuple[int, LogEntry]]

    def part(self, first: int, last: int) -> SampleBlock:
        """Returns rows `first` to `last - 1` as a block with the messages due by then; the last rows take all left."""
        since = int(self.time_ns[first - 1]) if first else -1
        until = int(self.time_ns[last - 1]) if last < self.time_ns.size else _MOST_NS
        return SampleBlock(
            self.time_ns[first:last],
            {name: values[first:last] for name, values in self.signals.items()},
            {name: (places[first:last], turns[first:last]) for name, (places, turns) in self.frames.items()},
            {
                name: [(row - first, part) for row, part in found if first <= row < last]
                for name, found in self.scene.items()
            },
            [message for message in self.messages if since < message[0] <= until],
        )


class Content:
    """Content of a finished run's export.

    Args:
        run: simulated, or estimated from telemetry.
        epoch_s: time of the run's time zero, s since 1970; None: times are those of the run.

    Raises:
        InputError: when the run has no samples, or its times are none that files can hold.
    """

    def __init__(self, run: RunContent, *, epoch_s: float | None = None):
        self._run, self._scenario = run, run.scenario
        self._vehicle = run.scenario.vehicle_data
        self._names = list(run.descriptions)
        self._epoch_s = epoch_s or 0.0
        time_s = np.asarray(run.time_s)
        if not time_s.size:
            raise InputError(f"run of '{run.scenario.name}': has no samples to export")
        for end_s in (float(time_s[0]), float(time_s[-1])):
            if not 0.0 <= 1e9 * (end_s + self._epoch_s) < _MOST_NS:
                raise InputError(
                    f"run of '{run.scenario.name}': has the time {end_s + self._epoch_s:g} s; "
                    "files of other programs hold times from zero on, to the year 2106; give another epoch"
                )
        self._sources = {name: parts for name, parts in _POSES.items() if set(parts) <= set(self._names)}
        self._simulated = "thrust" in self._names
        self._end_s = float(time_s[-1])
        self._messages = _messages(run, self._notes())
        self._found = event_marks.detection_marks(run)
        self._before: dict[str, Arrows | Balls] = {}
        self.outline = self._make_outline(int(self._to_ns(time_s[:1])[0]), has_epoch=epoch_s is not None)

    def stretches(self) -> Iterator[SampleBlock]:
        """Yields the run in sample blocks of some thousand rows, each with the messages up to its end."""
        self._before = {}
        signals = self._run.signals
        if isinstance(signals, Spool):
            blocks: Iterator[dict[str, Array]] = signals.blocks("time_s", *self._names)
        else:
            blocks = self._memory_blocks()
        waiting = list(self._messages)
        for block in blocks:
            time_s = block.pop("time_s")
            is_last = bool(time_s[-1] >= self._end_s)
            due_messages = [message for message in waiting if is_last or message.time_s <= time_s[-1]]
            waiting = waiting[len(due_messages) :]
            yield self._make_block(time_s, {name: np.asarray(block[name]) for name in self._names}, due_messages)

    # --------------------------------------------------------------------------------------- parts

    def _memory_blocks(self) -> Iterator[dict[str, Array]]:
        """Yields times and signals of a run held in memory, as dicts of arrays, some thousand rows at a time."""
        times = np.asarray(self._run.time_s)
        for first in range(0, times.size, _ROWS):
            rows = slice(first, first + _ROWS)
            yield {"time_s": times[rows], **{name: self._run.signals[name][rows] for name in self._names}}

    def _make_outline(self, start_ns: int, *, has_epoch: bool) -> Outline:
        """Makes the constant content: series of the signals, frames, and surfaces of body and nozzles."""
        vehicle, run = self._vehicle, self._run
        series = {
            name: Series(
                name,
                signal.label,
                run.components[name],
                component_units(run.units[name], len(run.components[name])),
            )
            for name, signal in run.descriptions.items()
        }
        body = [Mesh(solids.triangles(solid), _rgba(solid.color, _OPACITY)) for solid in solids.vehicle_solids(vehicle)]
        body += [Mesh(solids.nozzle(vehicle, jet), (64, 71, 84, 255)) for jet in range(len(vehicle.jets))]
        frames = [self._vehicle_frame(name) for name in self._sources]
        frames += [CENTER] * ("truth" in self._names) + [CENTER_ESTIMATED]
        return Outline(
            f"{self._scenario.name}: {vehicle.name}",
            start_ns,
            has_epoch,
            vehicle.unit_names["length"],
            solids.extent(vehicle),
            series,
            tuple(frames),
            {
                name: (vehicle.positions[jet], _rotation_from_z(self._plume_directions[jet]))
                for jet, name in enumerate(vehicle.designations)
            },
            body,
            self._notes(),
        )

    @property
    def _plume_directions(self) -> Array:
        """Unit vectors of the jets' plumes in the vehicle frame, shape (n_jets, 3)."""
        thrusts = self._vehicle.thrusts
        return np.asarray(-thrusts / np.linalg.norm(thrusts, axis=1, keepdims=True))

    def _vehicle_frame(self, source: str) -> str:
        """Returns the frame name for a source of poses: its own, or the vehicle's where no truth is known."""
        return source if VEHICLE in self._sources else VEHICLE

    def _notes(self) -> tuple[str, ...]:
        """Lists texts for the export's log: unit of lengths, and that poses or thrust are estimated or unknown."""
        unit = self._vehicle.unit_names["length"]
        notes = [f"lengths of frames and scene are in {unit}"]
        if not self._sources:
            notes.append("position and attitude are not known: the scene stands in the vehicle frame")
        elif VEHICLE not in self._sources:
            notes.append("position and attitude are the filter's estimates")
        if not self._simulated:
            notes.append("thrust is not known: plumes show the commands")
        return tuple(notes)

    def _to_ns(self, time_s: Array) -> NDArray[np.int64]:
        """Converts times of the run, s, to nanoseconds since the epoch."""
        return np.rint(1e9 * (time_s + self._epoch_s)).astype(np.int64)

    def _make_block(self, time_s: Array, signals: Mapping[str, Array], messages: Sequence[LogEntry]) -> SampleBlock:
        """Makes a sample block from signals: with poses of the frames, changes of the scene, and due messages."""
        time_ns = self._to_ns(time_s)
        scene: dict[str, list[tuple[int, Arrows | Balls]]] = {
            "plumes": self._changed_parts("plumes", self._plume_arrows(time_s, signals)),
            "marks": self._changed_parts("marks", self._jet_marks(time_s)),
            "centers": self._changed_parts("centers", self._center_balls(signals)),
        }
        if self._scenario.jumps and self._simulated:
            scene["payloads"] = self._changed_parts("payloads", self._payload_balls(time_s))
        times = np.clip(self._to_ns(np.array([one.time_s for one in messages])), self.outline.start_ns, None).tolist()
        return SampleBlock(time_ns, signals, self._frame_poses(signals), scene, list(zip(times, messages, strict=True)))

    def _frame_poses(self, signals: Mapping[str, Array]) -> dict[str, tuple[Array, Array]]:
        """Maps each moving frame to its origins, shape (n, 3), ft or m, and quaternions, shape (n, 4)."""
        frames = {}
        for source, (position, attitude, properties) in self._sources.items():
            rotation, center = signals[attitude], signals[properties][:, CENTER_OF_MASS]
            known = np.isfinite(rotation).all(axis=1) & np.isfinite(center).all(axis=1)
            origin = np.full(center.shape, np.nan)
            for row in np.flatnonzero(known).tolist():
                origin[row] = signals[position][row] - rotation_matrix(rotation[row]) @ center[row]
            frames[self._vehicle_frame(source)] = (origin, rotation)
        for name, properties in ((CENTER, "truth"), (CENTER_ESTIMATED, "estimate")):
            if properties in signals:
                center = signals[properties][:, CENTER_OF_MASS]
                frames[name] = (center, np.tile([1.0, 0.0, 0.0, 0.0], (len(center), 1)))
        return frames

    def _changed_parts(self, name: str, elements: Iterator[Arrows | Balls]) -> list[tuple[int, Arrows | Balls]]:
        """Returns the rows at which an element of the scene differs from the row before, each with the element."""
        changes = []
        for row, element in enumerate(elements):
            last_element = self._before.get(name)
            if last_element is None or not _are_equal(last_element, element):
                changes.append((row, element))
                self._before[name] = element
        return changes

    def _plume_arrows(self, time_s: Array, signals: Mapping[str, Array]) -> Iterator[Arrows]:
        """Yields arrows of all plumes per sample, colored by kind: regular, uncommanded or missing thrust."""
        vehicle = self._vehicle
        full = np.linalg.norm(vehicle.thrusts, axis=1)
        command = np.nan_to_num(signals["command"])
        thrust = np.nan_to_num(signals["thrust"]) if self._simulated else command * full
        failing = truly_failing(time_s, self._scenario) & self._simulated
        kinds = motion.classify_plumes(thrust / full, command > 0.0, failing)
        shown = np.where(kinds["withheld"], full, np.maximum(thrust, 0.0))
        vectors = solids.plume_lengths(vehicle, shown)[:, :, None] * self._plume_directions
        colors = {kind: _rgba(_PLUMES[kind], 0.75) for kind in _PLUMES}
        for row in range(time_s.size):
            jets = [(jet, kind) for kind in _PLUMES for jet in np.flatnonzero(kinds[kind][row]).tolist()]
            places = [jet for jet, _ in jets]
            yield Arrows(vehicle.positions[places], vectors[row, places], [colors[kind] for _, kind in jets])

    def _jet_marks(self, time_s: Array) -> Iterator[Balls]:
        """Yields balls per sample that mark the jets that truly fail or are declared failed."""
        vehicle = self._vehicle
        marks = [(mark, "failed") for mark in self._failures()] + [(mark, "found") for mark in self._found]
        radii = {kind: solids.mark_radius(vehicle, kind) for kind in _MARKS}
        for now_s in time_s.tolist():
            active = [(mark, kind) for mark, kind in marks if mark.start_s - 1e-9 <= now_s <= mark.end_s]
            shown = sorted({(jet, kind) for mark, kind in active for jet in mark.jets})
            yield Balls(
                vehicle.positions[[jet for jet, _ in shown]],
                np.repeat([radii[kind] for _, kind in shown], 3).reshape(-1, 3),
                [_rgba(_MARKS[kind], 0.55) for _, kind in shown],
            )

    def _failures(self) -> list[event_marks.Mark]:
        """Returns marks of the injected jet failures; none if the run is not simulated."""
        return event_marks.failure_marks(self._scenario, self._end_s) if self._simulated else []

    def _center_balls(self, signals: Mapping[str, Array]) -> Iterator[Balls]:
        """Yields balls per sample: true and estimated center of mass, and the estimate's 3-sigma ellipsoid."""
        radius = solids.center_radius(self._vehicle)
        estimate, deviation = (signals[name][:, CENTER_OF_MASS] for name in ("estimate", "standard_deviation"))
        truth = signals["truth"][:, CENTER_OF_MASS] if "truth" in signals else np.full(estimate.shape, np.nan)
        colors = [_rgba(TRUTH_COLOR, 0.45), _rgba(ESTIMATE_COLOR, 1.0), _rgba(ESTIMATE_COLOR, 0.22)]
        low, high = solids.spread_limits(self._vehicle)
        for row in range(len(estimate)):
            centers = np.stack([truth[row], estimate[row], estimate[row]])
            sizes = np.stack([np.full(3, radius), np.full(3, 0.7 * radius), np.clip(3.0 * deviation[row], low, high)])
            known = np.isfinite(centers).all(axis=1) & np.isfinite(sizes).all(axis=1)
            yield Balls(
                centers[known], sizes[known], [color for color, there in zip(colors, known, strict=True) if there]
            )

    def _payload_balls(self, time_s: Array) -> Iterator[Balls]:
        """Yields balls per sample for the payloads on board, sized by mass."""
        for now_s in time_s.tolist():
            on_board = [jump for jump in self._scenario.jumps if (now_s >= jump.time_s - 1e-9) == (jump.kind == "dock")]
            radii = [solids.payload_radius(self._vehicle, jump.mass) for jump in on_board]
            centers = np.array([jump.position for jump in on_board]).reshape(-1, 3)
            yield Balls(centers, np.repeat(radii, 3).reshape(-1, 3), [_rgba(PAYLOAD_COLOR, 0.6)] * len(on_board))


def component_units(unit: str, count: int) -> tuple[str, ...]:
    """Splits the unit text of a signal, such as "rad/s (3); ft/s (3); s; -", into the units of its columns."""
    found: list[str] = []
    for part in unit.split("; "):
        match = re.fullmatch(r"(.*) \((\d+)\)", part)
        found += [match[1]] * int(match[2]) if match else [part]
    return tuple(found) if len(found) == count else (unit,) * count


def _messages(run: RunContent, notes: Sequence[str]) -> list[LogEntry]:
    """Returns all log messages about a run, in order of time; the last is the verdict."""
    scenario, results = run.scenario, run.results
    units = scenario.vehicle_data.unit_names
    start_s, end_s = float(run.time_s[0]), float(run.time_s[-1])
    found = [LogEntry(start_s, "info", "run", note) for note in notes]
    if results.data_quality is not None:
        of_record = (*results.completeness_detail, *results.data_quality["warnings"])
        found += [LogEntry(start_s, "warning", "record", text) for text in of_record]
    if "thrust" in run.signals:
        found += [LogEntry(start_s, "warning", "scenario", str(doubt)) for doubt in scenario.simulation_doubts]
        for mark in event_marks.failure_marks(scenario, end_s):
            found.append(LogEntry(mark.start_s, "error", "scenario", f"{mark.text} begins"))
            if mark.end_s <= end_s:
                found.append(LogEntry(mark.end_s, "info", "scenario", f"{mark.text} ends"))
        for jump in scenario.jumps:
            if jump.time_s <= end_s:
                size = f"{jump.mass:g} {units['mass']}"
                found.append(LogEntry(jump.time_s, "info", "scenario", f"payload of {size}: {jump.kind}"))
    if results.events:
        found += [
            LogEntry(
                event.time_s,
                "info" if event.kind == "withdrawn" else "warning",
                "detector",
                event_in_words(event, units),
            )
            for event in results.events
        ]
    else:  # a run of an earlier version
        for entry in results.detections:
            words = detection_in_words(entry, units)
            found.append(LogEntry(entry.time_s, "warning", "detector", words))
            if entry.withdrawn_s is not None:
                found.append(LogEntry(entry.withdrawn_s, "info", "detector", f"withdrawn: {words}"))
    for one in results.unconfirmed:
        jets = f" {', '.join(one.jets)}" if one.jets else ""
        found.append(LogEntry(one.until_s, "info", "detector", f"suspected and not declared{jets}: {one.reason}"))
    found = sorted(found, key=lambda message: message.time_s)
    found += [LogEntry(end_s, "warning", "run", f"left out: {part}") for part in results.missing]
    if results.ended is not None:
        found.append(LogEntry(end_s, "error", "run", f"ended early: {results.ended.reason}"))
    return [*found, LogEntry(end_s, *_verdict(run))]


def _verdict(run: RunContent) -> tuple[Literal["info", "warning"], str, str]:
    """Returns severity, source and text of the message that closes a run: its consistency and declarations."""
    judged, standing = run.results.consistency, [one for one in run.results.detections if one.withdrawn_s is None]
    reasons = f": {'; '.join(judged.reasons)}" if judged.reasons else ""
    what = counted(len(standing), "declaration") if standing else "no failure found"
    level: Literal["info", "warning"] = "warning" if judged.verdict == "inconsistent" else "info"
    return level, "run", f"verdict: {judged.verdict or 'not judged'}{reasons}; {what}"


def _are_equal(one: Arrows | Balls, other: Arrows | Balls) -> bool:
    """Tests whether two elements of the scene are the same."""
    return one.colors == other.colors and all(
        np.array_equal(before, after) for before, after in zip(one[:2], other[:2], strict=True)
    )


def _rgba(color: str, opacity: float) -> Color:
    """Converts a color "#rrggbb" and an opacity to red, green, blue and opacity from 0 to 255."""
    red, green, blue = (int(color[start : start + 2], 16) for start in (1, 3, 5))
    return red, green, blue, round(255 * opacity)


def _rotation_from_z(direction: Array) -> Array:
    """Returns the quaternion (w, x, y, z) of a rotation that takes the z axis to a unit vector."""
    x, y, z = direction.tolist()
    if z < -1.0 + 1e-12:
        return np.array([0.0, 1.0, 0.0, 0.0])
    quaternion = np.array([1.0 + z, -y, x, 0.0])  # (1 + z . d, z x d)
    return np.asarray(quaternion / np.linalg.norm(quaternion))
