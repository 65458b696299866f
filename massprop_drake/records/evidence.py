"""Evidence of the jets in readings: when commands act, their scale, and the meaning of the readings."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.signals import AXES
from massprop_drake.maths.vehicle.thrust import level_after
from massprop_drake.records.channels import SAME_S, Channel, Mapped
from massprop_drake.records.mapped_rows import mean_over

FEWEST = 20  # components of samples in which jets fire, from which anything is told
ODDS = math.log(100.0)  # log of the odds from which one of two models is taken
_MEDIAN = 1.4826  # standard deviation over the median of absolute values, of the normal distribution
_POOR = 0.7  # correlation below which the jets explain less than half of the squared changes
_FIRES = 1e-3  # of the largest predicted change, from which one counts
_LEAST = 1e-12  # share of squared changes that arithmetic leaves unexplained
_SPREAD = 3.0  # of readings while coasting, in that of their changes, above which they are sums


class JetEvidence(NamedTuple):
    """Measured changes of a reading, and the changes that the jets should cause.

    Attributes:
        meant: predicted with the nominal mass properties, shape (n, 3).
        change: that is read, NaN where missing, shape (n, 3).
    """

    meant: Array
    change: Array

    @property
    def _firing(self) -> NDArray[np.bool_]:
        """Mask of components with a reading that the jets should change, shape (n, 3)."""
        largest = np.abs(self.meant).max(initial=0.0)
        mask: NDArray[np.bool_] = np.isfinite(self.change) & (np.abs(self.meant) > _FIRES * largest)
        return mask

    @property
    def _sums_of_products(self) -> tuple[float, float, float]:
        """Sums of predicted squared, predicted times measured, and measured squared changes of a reading."""
        mask = self._firing
        predicted, change = self.meant[mask], self.change[mask]
        return float((predicted**2).sum()), float((predicted * change).sum()), float((change**2).sum())

    @property
    def samples(self) -> int:
        """Number of components with a reading that the jets should change."""
        return int(self._firing.sum())

    @property
    def correlation(self) -> float:
        """Correlation of predicted and measured changes about zero; NaN with too few samples."""
        pp, pm, mm = self._sums_of_products
        return pm / math.sqrt(pp * mm) if self.samples >= FEWEST and pp * mm > 0.0 else math.nan

    @property
    def slope(self) -> float:
        """Ratio of measured to predicted change by least squares; NaN without a predicted change."""
        squared, mixed, _ = self._sums_of_products
        return mixed / squared if squared > 0.0 else math.nan

    @property
    def _fit(self) -> tuple[Array, Array]:
        """Changes in and beside samples in which jets fire, and as the best linear map of predicted ones, (k, 3) each.

        A spike elsewhere has no part in it.
        """
        fires = (np.abs(self.meant) > _FIRES * np.abs(self.meant).max(initial=0.0)).any(axis=1)
        near = fires | np.append(fires[1:], False) | np.insert(fires[:-1], 0, False)
        meant, changes = self.meant[near], self.change[near]
        fitted = np.full_like(changes, np.nan)
        for axis, change in enumerate(changes.T):
            known = np.isfinite(change)
            fitted[known, axis] = meant[known] @ np.linalg.lstsq(meant[known], change[known])[0]
        return changes, fitted

    @property
    def related(self) -> float:
        """Log likelihood ratio of the changes with the jets' effects and without; NaN with too few samples.

        It does not depend on axes, signs and units of the readings.
        """
        if math.isnan(self.correlation):
            return math.nan
        changes, fitted = self._fit
        readings, squared = np.isfinite(changes).sum(axis=0), np.nansum(changes**2, axis=0)
        moves = squared > 0.0
        left = np.nansum((changes - fitted) ** 2, axis=0)[moves] / squared[moves]
        return float(-0.5 * readings[moves] @ np.log(np.clip(left, _LEAST, 1.0)))

    @property
    def relation(self) -> float:
        """Correlation that `related` stands for, the same of every change; NaN with too few samples."""
        readings = np.isfinite(self._fit[0]).sum()
        return math.sqrt(-math.expm1(-2.0 * self.related / readings)) if readings else math.nan

    @property
    def gain(self) -> float:
        """Ratio of measured to predicted change, whatever the axes and signs; NaN without a predicted change."""
        squared = float((self.meant[np.isfinite(self.change).any(axis=1)] ** 2).sum())
        return math.sqrt(float(np.nansum(self._fit[1] ** 2)) / squared) if squared > 0.0 else math.nan

    @property
    def opposed(self) -> float:
        """Log likelihood ratio of the changes with reversed jets and without jets; NaN with too few samples."""
        return self._log_likelihood(-1.0)

    def _log_likelihood(self, sign: float) -> float:
        """Computes the log likelihood ratio of the changes with the jets' effects (times +1 or -1) and without."""
        if math.isnan(self.correlation):
            return math.nan
        return -0.5 * self.samples * math.log(max(1.0 - max(sign * self.correlation, 0.0) ** 2, _LEAST))

    @property
    def is_poor(self) -> bool:
        """True if the jets' effects correlate badly, and leave a residual beyond the scatter while coasting."""
        finite, firing = np.isfinite(self.change), self._firing
        coasting = np.abs(self.change[finite & ~firing])
        is_explained = self._log_likelihood(1.0) > ODDS  # without coasting: what is in part, should be
        scatter = 0.0 if is_explained else math.inf
        if coasting.size >= FEWEST:
            scatter = _MEDIAN * float(np.median(coasting))
        left = (self.change - self.slope * self.meant)[firing]
        return self.correlation < _POOR and math.sqrt(float((left**2).mean())) > _SPREAD * scatter

    @property
    def in_words(self) -> str:
        """Correlation as text; where it is poor, that of each axis, too."""
        axes = [JetEvidence(self.meant[:, [axis]], self.change[:, [axis]]) for axis in range(3)]
        texts = [f"{name} {one.correlation:.2f}" for name, one in zip(AXES, axes, strict=True) if one.samples >= FEWEST]
        return f"{self.correlation:.2f}" + (f" ({', '.join(texts)})" if self.correlation < _POOR else "")

    def shifted(self, rows: int) -> JetEvidence:
        """Returns the evidence with commands delayed by a number of rows, advanced where negative."""
        predicted = np.roll(self.meant, rows, axis=0)
        predicted[: max(rows, 0)] = 0.0
        predicted[len(predicted) + min(rows, 0) :] = 0.0
        return JetEvidence(predicted, self.change)


def compare_with_jet_effects(record: Mapped, name: str, *, gives: str = "") -> JetEvidence:
    """Pairs the measured changes of a gyro or accelerometer with those predicted from the commands.

    Args:
        record: mapped.
        name: of the sensor.
        gives: what to take an accelerometer's readings for; "": what the map says.
    """
    channel, vehicle = record.channels[name], record.vehicle
    steps = np.diff(channel.time_s)[:, None]
    predicted = _mean_levels(record, channel.time_s) @ _jet_effects(vehicle, name) * steps
    return JetEvidence(predicted, _reading_changes(channel, steps, gives or channel.gives))


def describe_misfit(name: str, noun: str, match: JetEvidence) -> str:
    """Describes a sensor's readings that oppose the jets' effects, or that these do not explain; "": neither.

    Args:
        name: of the sensor.
        noun: its readings are called.
        match: the evidence in them.
    """
    if match.opposed > ODDS:
        return (
            f"{name}: the {noun} go against what the jets should do, by a correlation of {match.in_words}: look at its "
            "axes, signs and `off`, `on`"
        )
    if match.is_poor:
        return (
            f"{name}: the {noun} follow the commands poorly, with a correlation of {match.in_words}: look at axes, "
            "signs, units and which jet is which, and whether these columns are its"
        )
    return ""


def describe_response(name: str, noun: str, match: JetEvidence) -> tuple[list[str], list[str]]:
    """Describes how a sensor's readings correlate with the jets' effects; returns sentences, and warnings.

    Arguments as of `describe_misfit`.
    """
    if misfit := describe_misfit(name, noun, match):
        return [], [misfit]
    if math.isnan(match.correlation):
        return [], []
    return [f"{name}: the {noun} follow the commands with a correlation of {match.in_words}"], []


def describe_evidence(record: Mapped) -> tuple[list[str], list[str]]:
    """Describes how each sensor's readings correlate with the commands; returns sentences, and warnings."""
    sentences, warnings = list[str](), list[str]()
    for name, channel in record.channels.items():
        if channel.kind in ("gyro", "accelerometer") and channel.time_s.size > 1:
            noun = "rates" if channel.kind == "gyro" else "readings"
            texts, doubted = describe_response(name, noun, compare_with_jet_effects(record, name))
            sentences += texts
            warnings += doubted
    return sentences, warnings


def _reading_changes(channel: Channel, steps: Array, gives: str) -> Array:
    """Computes changes of rate or velocity from sample to sample, NaN where missing, shape (n - 1, 3)."""
    values = channel.values
    if gives in ("", "integral"):
        return np.diff(values, axis=0)
    return values[1:] if gives == "increment" else values[1:] * steps


def _mean_levels(record: Mapped, time_s: Array) -> Array:
    """Computes mean thrust of each jet over its full thrust between times, by its delay and lag, (n - 1, n_jets)."""
    vehicle, held = record.vehicle, record.commands
    if record.by.commands.is_timed:  # a share of the sample period, not of the row, which may be shorter
        rows = vehicle.sample_period_s / (held.end_s - held.begin_s)
        held = held._replace(values=np.minimum(held.values * rows[:, None], 1.0))
    constants_s, shares = vehicle.time_constants_s, np.zeros((time_s.size - 1, len(vehicle.jets)))
    for delay_s in np.unique(vehicle.command_delays_s):
        late = vehicle.command_delays_s == delay_s
        shares[:, late] = np.nan_to_num(mean_over(held, time_s - delay_s)[:-1, late])
    steps = np.diff(time_s)[:, None]
    remaining = np.exp(-steps / np.maximum(constants_s, SAME_S))
    levels = np.zeros((time_s.size, len(vehicle.jets)))
    for row, share in enumerate(shares):
        levels[row + 1] = level_after(levels[row], share, remaining[row])
    mean: Array = shares - constants_s * np.diff(levels, axis=0) / steps  # the lag stores the rest
    return mean


def _jet_effects(vehicle: Vehicle, name: str) -> Array:
    """Computes the rate of change of a sensor's reading by each jet, nominal mass properties, (n_jets, 3)."""
    nominal, wrenches = vehicle.nominal, vehicle.wrenches
    turning = (wrenches[:, :3] - np.cross(nominal.center_of_mass, wrenches[:, 3:])) @ np.linalg.inv(nominal.inertia).T
    position = next((one.position for one in vehicle.accelerometers if one.name == name), None)
    if position is None:
        effects: Array = turning
    else:
        effects = wrenches[:, 3:] / nominal.mass + np.cross(turning, np.subtract(position, nominal.center_of_mass))
    return effects


def keeps_its_level(record: Mapped, name: str) -> bool:
    """Tests whether a reading while coasting scatters far more than its changes, as summed increments do."""
    channel = record.channels[name]
    shares = np.nan_to_num(mean_over(record.commands, channel.time_s), nan=1.0)
    coasting = (shares[:-2] == 0.0).all(axis=1) & (shares[1:-1] == 0.0).all(axis=1)
    values, changes = channel.values[2:][coasting], np.diff(channel.values, axis=0)[1:][coasting]
    finite = np.isfinite(values).all(axis=1) & np.isfinite(changes).all(axis=1)
    if finite.sum() < FEWEST:
        return False
    return bool(np.median(values[finite].std(axis=0)) > _SPREAD * np.median(changes[finite].std(axis=0)))
