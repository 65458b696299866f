"""Figures 5-6 to 5-11: inverse inertia and center of mass, dynamic coupling and second-order terms."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from itertools import pairwise

import numpy as np
from matplotlib.figure import Figure

from massprop_drake.display.figures import set_symmetric_log
from massprop_drake.maths.signals import AXES, SYMBOLS, mass_property_units
from reproduction import flights, words
from reproduction.cases import Calculation
from reproduction.checks import first_update, first_updates
from reproduction.claims import (
    Array,
    AtLeast,
    AtMost,
    Because,
    Between,
    Claim,
    Measure,
    Near,
    Phase,
    Phases,
    Pooled,
    Printed,
    Reading,
    Signals,
    expected,
    reference,
)
from reproduction.drawing import consistency, curves, panels
from reproduction.entry import Entry
from reproduction.measures import (
    CENTER,
    DIAGONAL,
    END_S,
    XX,
    XY,
    XZ,
    YY,
    YZ,
    ZZ,
    difference_in_sigma,
    during,
    maneuver_windows,
    mean_nis,
    nis,
    orbiter,
    percent_at,
    percent_error,
    ratio,
    rms,
    share_above,
    sigma_percent,
    used,
    value,
    worst,
)
from reproduction.pure_rotations import pure_rotations

_PURE = Calculation("pure_rotations", pure_rotations, seeds=20)
_COUPLING = {"with": flights.HYBRID, "without": flights.IGNORED}
_COUPLING_LABELS = {"with": "coupling subtracted (hybrid)", "without": "not subtracted"}
_ORDERS = {"second": flights.HYBRID, "linear": flights.EXTENDED}
_ORDER_LABELS = {"second": "second-order filter", "linear": "extended Kalman filter"}


def _error_ratio_without_subtraction(phase: Phase) -> float:
    """Computes the ratio of the diagonal's errors without over with subtraction, geometric mean from 11 s on."""
    size = {
        case: np.log([rms(row) for row in percent_error(run)[run["time_s"] >= 11.0, DIAGONAL]])
        for case, run in phase.items()
        if case in _COUPLING
    }
    return float(np.exp((size["without"] - size["with"]).mean()))


def _coupling_difference(phase: Phase) -> float:
    """Computes the largest difference that subtraction makes in an error of the diagonal, % of the initial error."""
    difference = percent_error(phase["with"])[:, DIAGONAL] - percent_error(phase["without"])[:, DIAGONAL]
    return float(np.abs(difference).max())


def _off_axis_torques(phase: Phase) -> tuple[float, float]:
    """Computes the RMS torque about the axes not commanded in single rotations: jets', and coupling's, ft-lbf."""
    run, inertia = phase["with"], orbiter().nominal.inertia
    jets, coupling = [], []
    for window in maneuver_windows()[:6]:
        firing = during(run, window.start_s, window.end_s) & np.any(run["torque"] != 0.0, axis=1)
        rate, axis = run["rate"][firing], AXES.index(window.axis[1])
        jets.append(np.delete(run["torque"][firing], axis, axis=1))
        coupling.append(np.delete(np.cross(rate, rate @ inertia), axis, axis=1))
    return rms(np.concatenate(jets)), rms(np.concatenate(coupling))


def _accurate_from_s(run: Signals, element: int, digits: int) -> float:
    """Returns the time from which on an estimate has its first digits right, s; infinity: not at the end."""
    truth = abs(float(run["truth"][0, element]))
    unit = 10.0 ** (math.floor(math.log10(truth)) - digits + 1)
    wrong = np.flatnonzero(np.abs(run["truth"][:, element] - run["estimate"][:, element]) > 0.5 * unit)
    if not wrong.size:
        return float(run["time_s"][0])
    return float(np.append(run["time_s"], np.inf)[wrong[-1] + 1])


def _time_between_digits_s(phase: Phase) -> float:
    """Computes the time from four digits of Izz^-1 to one of Iyz^-1, s; infinity: the latter never comes."""
    diagonal, product = _accurate_from_s(phase["with"], ZZ, 4), _accurate_from_s(phase["with"], YZ, 1)
    return product - diagonal if np.isfinite(diagonal) else -np.inf


def _product_error_ratio(phase: Phase) -> float:
    """Computes the ratio of the typical error of Ixy^-1 or Iyz^-1, the smaller, to that of Ixz^-1."""
    sizes = {element: _typical_percent(phase["with"], element) for element in (XZ, XY, YZ)}
    return min(sizes[XY], sizes[YZ]) / sizes[XZ]


def _diagonal_settled_s(phase: Phase) -> float:
    """Returns the time from which on the diagonal is within 0.1 %, s; infinity: not at the end."""
    run = phase["with"]
    wrong = np.flatnonzero(np.abs(percent_error(run)[:, DIAGONAL]).max(axis=1) > 0.1)
    return float(np.append(run["time_s"], np.inf)[wrong[-1] + 1])


def _error_after_updates(count: int, case: str) -> Measure:
    """Makes a measure: the error of Ixx^-1 after a number of used samples, %."""

    def measure(phase: Phase) -> float:
        """Computes the error in one phase, %."""
        run = phase[case]
        sample = int(np.flatnonzero(used(run, "rotation"))[count - 1])
        return float(abs(percent_error(run)[sample, XX]))

    return measure


def _error_after_exact_update(phase: Phase) -> float:
    """Computes the error of Ixx^-1 after the jets of the first used sample, measured without noise, %."""
    run = phase["with"]
    sample = int(np.flatnonzero(used(run, "rotation"))[0])
    return first_update([int(jet) for jet in np.flatnonzero(run["command"][sample - 1])])


def _typical_percent(run: Signals, element: int) -> float:
    """Computes the geometric mean of an error's size from 11 s on, when every axis has been turned about, %."""
    late = run["time_s"] >= 11.0
    return float(np.exp(np.log(np.abs(percent_error(run)[late, element])).mean()))


def _count_steps_up(phase: Phase) -> float:
    """Counts which of the three steps diagonal, xz, xy, yz are steps up in the size of the error from 11 s on."""
    sizes = [max(_typical_percent(phase["with"], element) for element in (XX, YY, ZZ))]
    sizes += [_typical_percent(phase["with"], element) for element in (XZ, XY, YZ)]
    return float(sum(small <= large for small, large in pairwise(sizes)))


def _yz_error_ratio(phase: Phase) -> float:
    """Computes the final error of Iyz^-1 over the largest of the other five."""
    errors = percent_at(phase["with"])[:6]
    return float(errors[YZ] / np.delete(errors, YZ).max())


def _improvement(element: int) -> Pooled:
    """Makes a pooled measure: the median error just before the first translation over that after it."""

    def measure(phases: Phases) -> float:
        """Computes the ratio over all phases."""
        before, after = (np.median([percent_at(phase["with"], t)[element] for phase in phases]) for t in (24.9, 27.5))
        return float(before / after)

    return measure


_KNOWN_BEFORE = Because(
    "there is little left to improve: residual force has shown the center of mass before 25 s, to {:.2f} % in x and "
    "{:.2f} % in z (1-sigma), so the first translation takes the 1-sigma of Ixy⁻¹ only from {:.2f} to {:.2f} % and "
    "that of Iyz⁻¹ from {:.1f} to {:.1f} %",
    (
        sigma_percent("with", 6, 24.9),
        sigma_percent("with", 8, 24.9),
        *(sigma_percent("with", element, time_s) for element in (XY, YZ) for time_s in (24.9, 27.5)),
    ),
)


def _true_orders(_: Phase) -> float:
    """Computes the orders of magnitude of Izz^-1 over Iyz^-1, true values."""
    truth = orbiter().nominal.vector()
    return float(np.log10(truth[ZZ] / truth[YZ]))


_MORE_AT_THE_END = Because(
    "until 37 s the two differ by {:.2f} of the filter's 1-sigma, then rates rise and they end {:.1f} of it apart: "
    "errors are {:.4f} % with and {:.3f} % without subtraction",
    (
        difference_in_sigma("with", "without", 36.9),
        difference_in_sigma("with", "without", END_S),
        worst("with"),
        worst("without"),
    ),
)


def coupling_bias(rates: tuple[float, float, float]) -> float:
    """Computes what dynamic coupling adds to the consistency function (NIS) at rates in multiples of 0.5 deg/s."""
    vehicle = orbiter()
    inertia = vehicle.nominal.inertia
    rate = np.radians(0.5) * np.array(rates)
    increment = np.linalg.solve(inertia, np.cross(rate, inertia @ rate)) * vehicle.sample_period_s
    return float(increment @ increment / (vehicle.gyros[0].quantum ** 2 / 6.0))


def _peak(case: str, start_s: float, end_s: float) -> Measure:
    """Makes a measure: largest value of the rotation filter's consistency function over a time."""
    return lambda phase: float(nis(phase[case], "rotation", start_s, end_s).max())


# ----------------------------------------------------------------------------------------- pictures


def _draw_errors(
    title: str, elements: tuple[int, ...], labels: Mapping[str, str], linear_share: float
) -> Callable[[Phases], Figure]:
    """Makes a function that draws estimation errors, true minus estimate, linear up to a share of the truth."""

    def error(element: int) -> Callable[[Signals], Array]:
        """Makes a function that returns the error of an element, true minus estimate."""
        return lambda run: run["truth"][:, element] - run["estimate"][:, element]

    def draw(phases: Phases) -> Figure:
        """Draws the picture from all phases."""
        figure, axes = panels(len(elements), title)
        units = mass_property_units(orbiter().unit_names)
        for panel, element in zip(axes, elements, strict=True):
            curves(panel, phases, labels, error(element))
            truth = abs(float(phases[0][next(iter(labels))]["truth"][0, element]))
            largest = max(float(np.abs(error(element)(phases[0][case])).max()) for case in labels)
            set_symmetric_log(panel, linear_share * truth, max(truth, largest))
            panel.set_ylabel(f"{SYMBOLS[element]}, {units[element]}", fontsize=8)
        return figure

    return draw


_TITLE = "Estimation error, true minus estimate"

# fmt: off
ENTRIES = (
    Entry("fig_5_6", "Effect of dynamic coupling on the inverse inertia",
        {**_COUPLING, "groups": Calculation("first_updates", first_updates)}, (
            Claim(1, "largest difference that subtraction makes in an error of the diagonal, of the initial error",
                "as is clearly seen, the coupling has a rather minor effect on the error histories", words.NOT_SEEN,
                _coupling_difference, "%"),
            Claim(1, "largest final error of the diagonal, without over with subtraction", "a rather minor effect",
                words.SLIGHTLY_MORE, ratio(worst("without"), worst("with")), because=_MORE_AT_THE_END),
            Claim(1, "errors of the diagonal without over those with subtraction, geometric mean from 11 s on",
                "convergence being somewhat more rapid when the coupling is subtracted", words.SLIGHTLY_MORE,
                _error_ratio_without_subtraction),
            Claim(2, "error of Ixx⁻¹ after the first used sample", "drops from 100 % to 3 % at the first used sample",
                Printed(3.0), _error_after_updates(1, "with"), "%",
                because=Because(
                    "it follows from the jets that fire first: an exact measurement of those here gives {:.1f} %. Over "
                    "all pairs and triples of primary jets that mainly roll the vehicle it is {:.1f} % in the median, "
                    "below 4 % for {:.0%} and above 6 % for {:.0%} of them. The second sample leaves {:.1f} % here",
                    (_error_after_exact_update, lambda phase: float(np.median(phase["groups"]["percent"])),
                     lambda phase: float(np.mean(phase["groups"]["percent"] < 4.0)),
                     lambda phase: float(np.mean(phase["groups"]["percent"] > 6.0)), _error_after_updates(2, "with")))),
            Claim(2, "the same", "a drastic drop at the first used sample", Reading(AtMost(10.0), "drastic: tenfold"),
                _error_after_updates(1, "with"), "%"),
            Claim(2, "the same, not subtracted", "in both cases", Reading(AtMost(10.0), "drastic: tenfold"),
                _error_after_updates(1, "without"), "%"),
            reference(2, "error of Ixx⁻¹ after three used samples", "(below 3 % after a few)", AtMost(3.0),
                _error_after_updates(3, "with"), "%"),
            Claim(3, "error of Iyy⁻¹ at 5 s over that at 7 s",
                "errors of the diagonal rapidly decrease when there is torque about the axis", words.MUCH_MORE,
                ratio(worst("with", YY, 4.9), worst("with", YY, 7.0))),
            Claim(3, "error of Izz⁻¹ at 9 s over that at 11 s",
                "errors of the diagonal rapidly decrease when there is torque about the axis", words.MUCH_MORE,
                ratio(worst("with", ZZ, 8.9), worst("with", ZZ, 11.0))),
            Claim(3, "larger error of Iyy⁻¹ at 4.9 s and Izz⁻¹ at 8.9 s",
                "some convergence earlier, from residual torque",
                Reading(AtMost(50.0), "some: half of the error is gone"),
                lambda phase: max(percent_at(phase["with"], 4.9)[YY], percent_at(phase["with"], 8.9)[ZZ]), "%"),
            reference(3, "largest error of the diagonal at 11 s", "(below 0.1 % for all three at 11 s)", AtMost(0.1),
                worst("with", DIAGONAL, 11.0), "%",
                because=Because("it is within 0.1 % from {:.1f} s on", (_diagonal_settled_s,))),
            Claim(4, "steps up in the typical error from 11 s on in the order diagonal, xz, xy, yz, of three",
                "convergence of the off-diagonals is slower; xz, the most significant, fastest; yz worst", AtLeast(3.0),
                _count_steps_up),
            Claim(4, "typical error from 11 s on, smaller of Ixy⁻¹ and Iyz⁻¹ over Ixz⁻¹",
                "xz: its convergence is much faster than the others", words.MUCH_MORE, _product_error_ratio),
            reference(5, "error of Iyz⁻¹ at the end", "(tens of percent)", Between(10.0, 100.0), worst("with", YZ),
                "%"),
            Claim(5, "the same over the largest of the other five", "yz is worst", AtLeast(1.0), _yz_error_ratio),
            reference(5, "Izz⁻¹ over Iyz⁻¹, true values", "(true ratio 2.5e3)", Near(2508.0, 1.0),
                lambda _: float(orbiter().nominal.vector()[ZZ] / orbiter().nominal.vector()[YZ])),
            Claim(5, "orders of magnitude of the same", "yz is four orders of magnitude smaller than zz",
                words.orders(4), _true_orders,
                because=Because("table 5-2 itself: {:.2f} orders", (_true_orders,))),
            Claim(5, "time from when Izz⁻¹ keeps four digits to when Iyz⁻¹ keeps one; inf: it never does",
                "zz must be accurate to four digits before yz is accurate to one",
                Reading(AtLeast(0.0), "n digits: to half a unit of the n-th"), _time_between_digits_s, "s"),
            Claim(6, "median error of Ixy⁻¹ just before the first translation over that after it",
                "once the center of mass is known, off-diagonals improve considerably after the first translation",
                words.CONSIDERABLE, _improvement(XY), pooled=True, because=_KNOWN_BEFORE),
            Claim(6, "the same of Iyz⁻¹", "off-diagonals improve considerably after the first translation",
                words.CONSIDERABLE, _improvement(YZ), pooled=True, because=_KNOWN_BEFORE),
            Claim(3, "torque that coupling amounts to about the axes not commanded, over that of the jets there, RMS",
                "the subtracted term is essentially the same size as the residual torque due to the jets",
                words.COMPARABLE, lambda phase: _off_axis_torques(phase)[1] / _off_axis_torques(phase)[0],
                because=Because(
                    "in turns at 0.5 deg/s about one axis coupling amounts to {:.1f} ft-lbf about the others, and the "
                    "jets selected here give {:.0f} ft-lbf there while they fire",
                    (lambda phase: _off_axis_torques(phase)[1], lambda phase: _off_axis_torques(phase)[0]))),
        ),
        {
            "fig_5_6a": _draw_errors(f"{_TITLE}: diagonal (figure 5-6a)", (XX, YY, ZZ), _COUPLING_LABELS, 1e-3),
            "fig_5_6b": _draw_errors(f"{_TITLE}: products (figure 5-6b)", (XY, YZ, XZ), _COUPLING_LABELS, 1e-2),
        },
    ),
    Entry("fig_5_7", "Effect of dynamic coupling on the center of mass", {**_COUPLING, "pure": _PURE}, (
            Claim(1, "larger error of x and z just before 25 s", "x and z were able to converge somewhat even before",
                Reading(AtMost(50.0), "somewhat: half of the error is gone"), worst("with", [6, 8], 24.9), "%"),
            Claim(1, "1-sigma of the center of mass after rotations by torque alone, over that at the start",
                "under pure rotations the center of mass would have been completely unobservable", Near(1.0, 1e-12),
                lambda phase: float(phase["pure"]["center_std"].min())),
            Claim(1, "change of its error in these rotations, of the initial error",
                "and the estimation error would have been constant", AtMost(1e-9), value("pure", "center"), "%"),
            Claim(2, "larger error of x and z at 27.5 s",
                "after the first translation all immediately approach good values", words.GOOD,
                worst("with", [6, 8], 27.5), "%"),
            Claim(2, "error of y at 27.5 s", "after the first translation all immediately approach good values",
                Reading(AtMost(5.0), "good: a few percent of its 0.07 ft"), worst("with", 7, 27.5), "%"),
            Claim(2, "largest of the three at 27.5 s, coupling not subtracted", "in both cases",
                Reading(AtMost(5.0), "good: a few percent"), worst("without", CENTER, 27.5), "%"),
        ),
        {"fig_5_7": _draw_errors(f"{_TITLE}: center of mass (figure 5-7)", (6, 7, 8), _COUPLING_LABELS, 1e-3)},
    ),
    Entry("fig_5_8", "Effect of dynamic coupling on the rotation consistency function",
        {**_COUPLING, "unguarded": flights.SUBTRACTED}, (
            Claim(1, "mean after 5 s, coupling subtracted",
                "appears to follow chi-square with 3 degrees of freedom, except initially", words.CHI_SQUARE,
                mean_nis("with", "rotation", 5.0)),
            Claim(1, "share of samples above 11.34 after 5 s", "appears to follow chi-square",
                Reading(AtMost(0.02), "like chi-square: 1 %, at most twice that"), share_above("with", 11.34, 5.0)),
            Claim(2, "mean from 5 to 25 s without over that with subtraction",
                "until 25 s the performance of both is essentially the same", words.SAME,
                ratio(mean_nis("without", "rotation", 5.0, 24.9), mean_nis("with", "rotation", 5.0, 24.9))),
            Claim(3, "mean from 37 to 46 s over that from 25 to 37 s, not subtracted",
                "the function drastically increases at 37 s, when rates rise", words.DRASTIC,
                ratio(mean_nis("without", "rotation", 37.0, 46.0), mean_nis("without", "rotation", 25.0, 36.9)),
                because=Because(
                    "the mean is {:.1f} from 25 to 37 s, then {:.0f} with x and y commanded, {:.0f} with y and z, "
                    "{:.0f} with z and x: coupling adds little about y and z (worked out below)",
                    tuple(mean_nis("without", "rotation", *times_s)
                          for times_s in ((25.0, 36.9), (37.0, 40.0), (40.1, 43.0), (43.1, 46.0))))),
            reference(3, "peak from 37 to 46 s, not subtracted", "(peaks of 60 to 90 follow from the coupling)",
                Between(60.0, 90.0), _peak("without", 37.0, 46.0)),
            expected(3, "what coupling adds at 0.5 deg/s about x and y", "67", Near(67.0, 0.5),
                lambda _: coupling_bias((1.0, 1.0, 0.0))),
            expected(3, "about y and z", "13", Near(13.0, 0.5), lambda _: coupling_bias((0.0, 1.0, 1.0))),
            expected(3, "about x and z", "81", Near(81.0, 0.5), lambda _: coupling_bias((1.0, 0.0, 1.0))),
            expected(3, "about one axis, largest", "at most 0.13", AtMost(0.135),
                lambda _: max(coupling_bias((1.0, 0.0, 0.0)), coupling_bias((0.0, 1.0, 0.0)),
                    coupling_bias((0.0, 0.0, 1.0)))),
            Claim(4, "peak before 8 s with unguarded subtraction over that of the hybrid",
                "poor estimates of the coupling can degrade the filter initially", words.MUCH_MORE,
                ratio(_peak("unguarded", 0.0, 8.0), _peak("with", 0.0, 8.0))),
            Claim(4, "mean from 2.5 to 4 s, unguarded over hybrid", "as is manifest around 3 seconds",
                Reading(AtLeast(1.1), "manifest: a tenth more"),
                ratio(mean_nis("unguarded", "rotation", 2.5, 4.0), mean_nis("with", "rotation", 2.5, 4.0)),
                because=Because(
                    "here poor estimates do their harm when the next axis turns: the largest value is {:.0f} until 4 s "
                    "and {:.2g} from there to 8 s, with the hybrid {:.0f} and {:.0f}",
                    (_peak("unguarded", 2.5, 4.0), _peak("unguarded", 4.0, 8.0), _peak("with", 2.5, 4.0),
                     _peak("with", 4.0, 8.0)))),
        ),
        {
            "fig_5_8": consistency(
                "rotation",
                "Consistency function of the rotation filter, used samples (figure 5-8)",
                {**_COUPLING_LABELS, "unguarded": "subtracted from the start"},
                symbol="e' Y⁻¹ e",
            )
        },
    ),
    Entry("fig_5_9", "Effect of second-order terms on the inverse inertia",
        {**_ORDERS, "no_bias": flights.WITHOUT_BIAS, "no_covariance": flights.WITHOUT_COVARIANCE, "pure": _PURE}, (
            Claim(1, "largest final error of the diagonal, extended Kalman over second-order filter",
                "divergence and tremendous final errors", words.TREMENDOUS, ratio(worst("linear"), worst("second"))),
            Claim(1,
                "largest error of the diagonal after the rotations, 24.9 s, extended Kalman over second-order filter",
                "small residual force in rotations is significant enough to cause the filter to diverge",
                words.TREMENDOUS, ratio(worst("linear", DIAGONAL, 24.9), worst("second", DIAGONAL, 24.9))),
            Claim(1, "the same ratio after rotations by torque alone", "it is the residual force that causes it",
                words.SAME, ratio(value("pure", "diagonal_extended"), value("pure", "diagonal"))),
            Claim(2, "mean consistency function without the bias alone, over that without both",
                "such inconsistency is caused primarily by the unmodeled bias term",
                Reading(AtLeast(0.5), "primarily: half of it"),
                ratio(mean_nis("no_bias", "rotation"), mean_nis("linear", "rotation")),
                because=Because(
                    "mean consistency function {:.3g} without both, {:.3g} without the covariance D alone (bias kept), "
                    "{:.3g} without the bias alone (D kept): the missing D does it",
                    (mean_nis("linear", "rotation"), mean_nis("no_covariance", "rotation"),
                     mean_nis("no_bias", "rotation")))),
            Claim(2, "mean consistency function without the bias alone",
                "the missing bias makes the residuals inconsistent", words.HIGHLY_INCONSISTENT,
                mean_nis("no_bias", "rotation")),
            Claim(2, "mean consistency function without the covariance D alone",
                "the missing matrix D causes Y to be too small as well", words.HIGHLY_INCONSISTENT,
                mean_nis("no_covariance", "rotation")),
        ),
        {
            "fig_5_9a": _draw_errors(f"{_TITLE}: diagonal (figure 5-9a)", (XX, YY, ZZ), _ORDER_LABELS, 1e-3),
            "fig_5_9b": _draw_errors(f"{_TITLE}: products (figure 5-9b)", (XY, YZ, XZ), _ORDER_LABELS, 1e-2),
        },
    ),
    Entry("fig_5_10", "Effect of second-order terms on the center of mass", _ORDERS, (
            Claim(1, "largest final error of the center of mass, extended Kalman over second-order filter",
                "divergence and tremendous final errors", words.TREMENDOUS,
                ratio(worst("linear", CENTER), worst("second", CENTER))),
            Claim(1, "largest final error of the center of mass, extended Kalman filter", "tremendous final errors",
                Reading(AtLeast(100.0), "tremendous: larger than at the start"), worst("linear", CENTER), "%"),
        ),
        {"fig_5_10": _draw_errors(f"{_TITLE}: center of mass (figure 5-10)", (6, 7, 8), _ORDER_LABELS, 1e-3)},
    ),
    Entry("fig_5_11", "Effect of second-order terms on the consistency function", _ORDERS, (
            Claim(1, "mean after 5 s, second-order filter",
                "appears to essentially follow central chi-square of three degrees of freedom", words.CHI_SQUARE,
                mean_nis("second", "rotation", 5.0)),
            Claim(2, "orders of magnitude by which the largest value of the extended Kalman filter exceeds 3",
                "too large by seven orders of magnitude when applied forces are large", words.orders(7),
                lambda phase: float(np.log10(_peak("linear", 0.0, np.inf)(phase) / 3.0))),
        ),
        {
            "fig_5_11": consistency(
                "rotation",
                "Consistency function of the rotation filter, used samples (figure 5-11)",
                _ORDER_LABELS,
                symbol="e' Y⁻¹ e",
            )
        },
    ),
)
# fmt: on
