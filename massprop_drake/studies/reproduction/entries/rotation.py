"""Figures 5-6 to 5-11: inverse inertia and center of mass, dynamic coupling and second-order terms."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import pairwise

import numpy as np
from matplotlib.figure import Figure

from massprop_drake.display.figures import symmetric_log
from massprop_drake.signals import SYMBOLS, mass_property_units
from massprop_drake.studies.reproduction.cases import Calculation
from massprop_drake.studies.reproduction.checks import first_update, first_updates
from massprop_drake.studies.reproduction.claims import (
    Array,
    AtLeast,
    AtMost,
    Because,
    Between,
    Claim,
    Near,
    Phase,
    Phases,
    Printed,
    Signals,
)
from massprop_drake.studies.reproduction.drawing import consistency, curves, panels
from massprop_drake.studies.reproduction.entry import Entry
from massprop_drake.studies.reproduction.flights import (
    EXTENDED,
    HYBRID,
    IGNORED,
    SUBTRACTED,
    WITHOUT_BIAS,
    WITHOUT_COVARIANCE,
)
from massprop_drake.studies.reproduction.measures import (
    CENTER,
    DIAGONAL,
    XX,
    XY,
    XZ,
    YY,
    YZ,
    ZZ,
    at,
    final_percent,
    mean_nis,
    nis,
    orbiter,
    percent_at,
    percent_error,
    rms,
    used,
)

_COUPLING = {"with": HYBRID, "without": IGNORED}
_COUPLING_LABELS = {"with": "coupling subtracted (hybrid)", "without": "not subtracted"}
_ORDERS = {"second": HYBRID, "linear": EXTENDED}
_ORDER_LABELS = {"second": "second-order filter", "linear": "extended Kalman filter"}


def _worst(case: str, elements: slice, phase: Phase) -> float:
    """Largest error of some elements at the end, %."""
    return float(final_percent(phase[case])[elements].max())


def _advantage(phase: Phase) -> float:
    """How many times larger the diagonal's errors are without subtraction, geometric mean over 11 to 50 s."""
    size = {
        case: np.log([rms(row) for row in percent_error(run)[run["time_s"] >= 11.0, DIAGONAL]])
        for case, run in phase.items()
        if case in _COUPLING
    }
    return float(np.exp((size["without"] - size["with"]).mean()))


def _after_updates(count: int, case: str) -> Callable[[Phase], float]:
    """Makes a measure: the error of Ixx^-1 after so many used samples, %."""

    def measure(phase: Phase) -> float:
        run = phase[case]
        sample = int(np.flatnonzero(used(run, "rotation"))[count - 1])
        return float(abs(percent_error(run)[sample, XX]))

    return measure


def _first_exactly(phase: Phase) -> float:
    """Error of Ixx^-1 after the jets of the first used sample, measured without noise, %."""
    run = phase["with"]
    sample = int(np.flatnonzero(used(run, "rotation"))[0])
    return first_update([int(jet) for jet in np.flatnonzero(run["command"][sample - 1])])


def _typical_percent(run: Signals, element: int) -> float:
    """Geometric mean of an error's size from 11 s on, when every axis has been turned about, %."""
    late = run["time_s"] >= 11.0
    return float(np.exp(np.log(np.abs(percent_error(run)[late, element])).mean()))


def _ordered(phase: Phase) -> float:
    """How many of the three steps diagonal, xz, xy, yz are steps up in the size of the error from 11 s on."""
    sizes = [max(_typical_percent(phase["with"], element) for element in (XX, YY, ZZ))]
    sizes += [_typical_percent(phase["with"], element) for element in (XZ, XY, YZ)]
    return float(sum(small <= large for small, large in pairwise(sizes)))


def _yz_is_worst(phase: Phase) -> float:
    errors = final_percent(phase["with"])[:6]
    return float(errors[YZ] / np.delete(errors, YZ).max())


def _improvement(element: int) -> Callable[[Phases], float]:
    """Makes a pooled measure: the median error just before the first translation over that after it."""

    def measure(phases: Phases) -> float:
        before, after = (np.median([percent_at(phase["with"], t)[element] for phase in phases]) for t in (24.9, 27.5))
        return float(before / after)

    return measure


def _sigma_percent(time_s: float, element: int) -> Callable[[Phase], float]:
    """Makes a measure: the filter's own 1-sigma at a time, %."""

    def measure(phase: Phase) -> float:
        run = phase["with"]
        sigma = run["standard_deviation"][at(run, time_s), element]
        return float(100.0 * sigma / abs(run["truth"][0, element]))

    return measure


_KNOWN_BEFORE = Because(
    "there is little left to improve: residual force has shown the center of mass before 25 s, to {:.2f} % in x and "
    "{:.2f} % in z (1-sigma), so the first translation takes the 1-sigma of Ixy⁻¹ only from {:.2f} to {:.2f} % and "
    "that of Iyz⁻¹ from {:.1f} to {:.1f} %",
    (
        _sigma_percent(24.9, 6),
        _sigma_percent(24.9, 8),
        *(_sigma_percent(time_s, element) for element in (XY, YZ) for time_s in (24.9, 27.5)),
    ),
)


def coupling_bias(rates: tuple[float, float, float]) -> float:
    """|I^-1 (w x I w) dt|^2 / (q^2 / 6) at rates in multiples of 0.5 deg/s: what coupling adds to the statistic."""
    vehicle = orbiter()
    inertia = vehicle.nominal.inertia
    rate = np.radians(0.5) * np.array(rates)
    increment = np.linalg.solve(inertia, np.cross(rate, inertia @ rate)) * vehicle.sample_period_s
    return float(increment @ increment / (vehicle.gyros[0].quantum ** 2 / 6.0))


def _peak(run: Signals, start_s: float, end_s: float) -> float:
    return float(nis(run, "rotation", start_s, end_s).max())


def _share_above(case: str, limit: float) -> Callable[[Phase], float]:
    return lambda phase: float(np.mean(nis(phase[case], "rotation", 5.0) > limit))


def _excess(elements: slice) -> Callable[[Phase], float]:
    """Makes a measure: the largest final error of the linear filter over that of the second-order one."""
    return lambda phase: _worst("linear", elements, phase) / _worst("second", elements, phase)


# ----------------------------------------------------------------------------------------- pictures


def _errors(
    title: str, elements: tuple[int, ...], labels: Mapping[str, str], small: float
) -> Callable[[Phases], Figure]:
    """Makes a picture of estimation errors, true minus estimate, on an axis that is linear up to a small share."""

    def error(element: int) -> Callable[[Signals], Array]:
        return lambda run: run["truth"][:, element] - run["estimate"][:, element]

    def draw(phases: Phases) -> Figure:
        figure, axes = panels(len(elements), title)
        units = mass_property_units(orbiter().unit_names)
        for panel, element in zip(axes, elements, strict=True):
            curves(panel, phases, labels, error(element))
            truth = abs(float(phases[0][next(iter(labels))]["truth"][0, element]))
            largest = max(float(np.abs(error(element)(phases[0][case])).max()) for case in labels)
            symmetric_log(panel, small * truth, max(truth, largest))
            panel.set_ylabel(f"{SYMBOLS[element]}, {units[element]}", fontsize=8)
        return figure

    return draw


_TITLE = "Estimation error, true minus estimate"

ENTRIES = (
    Entry(
        "fig_5_6",
        "Effect of dynamic coupling on the inverse inertia",
        {**_COUPLING, "groups": Calculation("first_updates", first_updates)},
        (
            Claim(
                1,
                "largest error of the diagonal at the end, coupling subtracted",
                "coupling has a rather minor effect",
                AtMost(0.05),
                lambda phase: _worst("with", DIAGONAL, phase),
                "%",
            ),
            Claim(
                1,
                "the same, not subtracted",
                "a rather minor effect: both final errors small",
                AtMost(0.2),
                lambda phase: _worst("without", DIAGONAL, phase),
                "%",
            ),
            Claim(
                1,
                "errors of the diagonal without over those with subtraction, geometric mean from 11 s on",
                "convergence is somewhat faster with subtraction",
                AtLeast(1.0),
                _advantage,
            ),
            Claim(
                2,
                "error of Ixx⁻¹ after the first used sample",
                "drops from 100 % to 3 % at the first used sample",
                Printed(3.0),
                _after_updates(1, "with"),
                "%",
                because=Because(
                    "it follows from the jets that fire first: an exact measurement of those here gives {:.1f} %. Over "
                    "all pairs and triples of primary jets that mainly roll the vehicle it is {:.1f} % in the median, "
                    "below 4 % for {:.0%} and above 6 % for {:.0%} of them. The second sample leaves {:.1f} % here",
                    (
                        _first_exactly,
                        lambda phase: float(np.median(phase["groups"]["percent"])),
                        lambda phase: float(np.mean(phase["groups"]["percent"] < 4.0)),
                        lambda phase: float(np.mean(phase["groups"]["percent"] > 6.0)),
                        _after_updates(2, "with"),
                    ),
                ),
            ),
            Claim(
                2,
                "the same",
                "a drastic drop at the first used sample",
                AtMost(10.0),
                _after_updates(1, "with"),
                "%",
            ),
            Claim(
                2,
                "the same, not subtracted",
                "in both cases",
                AtMost(10.0),
                _after_updates(1, "without"),
                "%",
            ),
            Claim(
                2,
                "error of Ixx⁻¹ after three used samples",
                "3 %",
                AtMost(3.0),
                _after_updates(3, "with"),
                "%",
            ),
            Claim(
                3,
                "error of Iyy⁻¹ at 5 s over that at 7 s",
                "each diagonal element drops quickly when torque about its axis first appears",
                AtLeast(3.0),
                lambda phase: percent_at(phase["with"], 4.9)[YY] / percent_at(phase["with"], 7.0)[YY],
            ),
            Claim(
                3,
                "error of Izz⁻¹ at 9 s over that at 11 s",
                "each diagonal element drops quickly when torque about its axis first appears",
                AtLeast(3.0),
                lambda phase: percent_at(phase["with"], 8.9)[ZZ] / percent_at(phase["with"], 11.0)[ZZ],
            ),
            Claim(
                3,
                "larger error of Iyy⁻¹ at 4.9 s and Izz⁻¹ at 8.9 s",
                "some convergence earlier, from residual torque",
                AtMost(50.0),
                lambda phase: max(percent_at(phase["with"], 4.9)[YY], percent_at(phase["with"], 8.9)[ZZ]),
                "%",
            ),
            Claim(
                3,
                "largest error of the diagonal at 11 s",
                "all three have settled once each axis has been turned about",
                AtMost(1.0),
                lambda phase: float(percent_at(phase["with"], 11.0)[DIAGONAL].max()),
                "%",
            ),
            Claim(
                4,
                "steps up in the typical error from 11 s on in the order diagonal, xz, xy, yz, of three",
                "off-diagonals converge more slowly; xz, the largest, fastest",
                AtLeast(3.0),
                _ordered,
            ),
            Claim(
                5,
                "error of Iyz⁻¹ at the end",
                "yz is worst",
                AtMost(60.0),
                lambda phase: float(final_percent(phase["with"])[YZ]),
                "%",
            ),
            Claim(
                5,
                "the same over the largest of the other five",
                "yz is worst",
                AtLeast(1.0),
                _yz_is_worst,
            ),
            Claim(
                5,
                "Izz⁻¹ over Iyz⁻¹, true values",
                "yz is four orders below zz",
                Near(2508.0, 1.0),
                lambda _: float(orbiter().nominal.vector()[ZZ] / orbiter().nominal.vector()[YZ]),
            ),
            Claim(
                6,
                "median error of Ixy⁻¹ just before the first translation over that after it",
                "off-diagonals improve markedly after the first translation, once the center of mass is known",
                AtLeast(1.2),
                _improvement(XY),
                pooled=True,
                because=_KNOWN_BEFORE,
            ),
            Claim(
                6,
                "the same of Iyz⁻¹",
                "off-diagonals improve markedly after the first translation",
                AtLeast(1.2),
                _improvement(YZ),
                pooled=True,
                because=_KNOWN_BEFORE,
            ),
        ),
        {
            "fig_5_6a": _errors(f"{_TITLE}: diagonal (figure 5-6a)", (XX, YY, ZZ), _COUPLING_LABELS, 1e-3),
            "fig_5_6b": _errors(f"{_TITLE}: products (figure 5-6b)", (XY, YZ, XZ), _COUPLING_LABELS, 1e-2),
        },
    ),
    Entry(
        "fig_5_7",
        "Effect of dynamic coupling on the center of mass",
        _COUPLING,
        (
            Claim(
                1,
                "larger error of x and z just before 25 s",
                "x and z converge partly before 25 s thanks to residual force",
                AtMost(50.0),
                lambda phase: float(percent_at(phase["with"], 24.9)[[6, 8]].max()),
                "%",
            ),
            Claim(
                2,
                "larger error of x and z at 27.5 s",
                "good right after the first translation",
                AtMost(1.0),
                lambda phase: float(percent_at(phase["with"], 27.5)[[6, 8]].max()),
                "%",
            ),
            Claim(
                2,
                "error of y at 27.5 s",
                "good right after the first translation (y a few percent)",
                AtMost(5.0),
                lambda phase: float(percent_at(phase["with"], 27.5)[7]),
                "%",
            ),
            Claim(
                2,
                "largest of the three at 27.5 s, coupling not subtracted",
                "in both cases",
                AtMost(5.0),
                lambda phase: float(percent_at(phase["without"], 27.5)[CENTER].max()),
                "%",
            ),
        ),
        {"fig_5_7": _errors(f"{_TITLE}: center of mass (figure 5-7)", (6, 7, 8), _COUPLING_LABELS, 1e-3)},
    ),
    Entry(
        "fig_5_8",
        "Effect of dynamic coupling on the rotation consistency function",
        {**_COUPLING, "unguarded": SUBTRACTED},
        (
            Claim(
                1,
                "mean after 5 s, coupling subtracted",
                "behaves like chi-square with 3 degrees of freedom (mean 3)",
                Between(2.5, 4.0),
                mean_nis("with", "rotation", 5.0),
            ),
            Claim(
                1,
                "share of samples above 11.34 after 5 s",
                "like chi-square: about 1 %",
                AtMost(0.03),
                _share_above("with", 11.34),
            ),
            Claim(
                2,
                "mean from 5 to 25 s without over that with subtraction",
                "both cases alike until about 25 s",
                Between(0.7, 1.5),
                lambda phase: (
                    mean_nis("without", "rotation", 5.0, 24.9)(phase) / mean_nis("with", "rotation", 5.0, 24.9)(phase)
                ),
            ),
            Claim(
                3,
                "mean from 37 to 46 s, not subtracted",
                "rises sharply at 37 s, when rates rise",
                AtLeast(9.0),
                mean_nis("without", "rotation", 37.0, 46.0),
            ),
            Claim(
                3,
                "peak from 37 to 46 s, not subtracted",
                "peaks of 60 to 90 follow from the coupling",
                Between(50.0, 120.0),
                lambda phase: _peak(phase["without"], 37.0, 46.0),
            ),
            Claim(
                3,
                "what coupling adds at 0.5 deg/s about x and y",
                "(expected 67)",
                Near(67.0, 0.5),
                lambda _: coupling_bias((1.0, 1.0, 0.0)),
            ),
            Claim(3, "about y and z", "(expected 13)", Near(13.0, 0.5), lambda _: coupling_bias((0.0, 1.0, 1.0))),
            Claim(3, "about x and z", "(expected 81)", Near(81.0, 0.5), lambda _: coupling_bias((1.0, 0.0, 1.0))),
            Claim(
                3,
                "about one axis, largest",
                "(expected at most 0.13)",
                AtMost(0.135),
                lambda _: max(coupling_bias((1.0, 0.0, 0.0)), coupling_bias((0.0, 1.0, 0.0)), coupling_bias((0, 0, 1))),
            ),
            Claim(
                4,
                "peak before 8 s with unguarded subtraction over that of the hybrid",
                "subtraction with poor estimates hurts; a hybrid is recommended",
                AtLeast(10.0),
                lambda phase: float(_peak(phase["unguarded"], 0.0, 8.0) / _peak(phase["with"], 0.0, 8.0)),
            ),
            Claim(
                4,
                "mean from 2.5 to 4 s, unguarded over hybrid",
                "it shows near 3 s",
                AtLeast(1.1),
                lambda phase: (
                    mean_nis("unguarded", "rotation", 2.5, 4.0)(phase) / mean_nis("with", "rotation", 2.5, 4.0)(phase)
                ),
            ),
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
    Entry(
        "fig_5_9",
        "Effect of second-order terms on the inverse inertia",
        {**_ORDERS, "no_bias": WITHOUT_BIAS, "no_covariance": WITHOUT_COVARIANCE},
        (
            Claim(
                1,
                "largest final error of the diagonal, extended Kalman over second-order filter",
                "extended Kalman filter diverges; tremendous final errors",
                AtLeast(100.0),
                _excess(DIAGONAL),
            ),
            Claim(
                2,
                "mean consistency function without the bias alone, over that without both",
                "the cause is the missing bias term (2-118)",
                AtLeast(0.1),
                lambda phase: mean_nis("no_bias", "rotation")(phase) / mean_nis("linear", "rotation")(phase),
                because=Because(
                    "mean consistency function {:.3g} without both, {:.3g} without the covariance D alone (bias kept), "
                    "{:.3g} without the bias alone (D kept): the missing D does it",
                    (
                        mean_nis("linear", "rotation"),
                        mean_nis("no_covariance", "rotation"),
                        mean_nis("no_bias", "rotation"),
                    ),
                ),
            ),
            Claim(
                2,
                "mean consistency function without the bias alone",
                "the missing bias makes the residuals inconsistent",
                AtLeast(30.0),
                mean_nis("no_bias", "rotation"),
            ),
            Claim(
                2,
                "mean consistency function without the covariance D alone",
                "the missing D makes Y too small as well",
                AtLeast(30.0),
                mean_nis("no_covariance", "rotation"),
            ),
        ),
        {
            "fig_5_9a": _errors(f"{_TITLE}: diagonal (figure 5-9a)", (XX, YY, ZZ), _ORDER_LABELS, 1e-3),
            "fig_5_9b": _errors(f"{_TITLE}: products (figure 5-9b)", (XY, YZ, XZ), _ORDER_LABELS, 1e-2),
        },
    ),
    Entry(
        "fig_5_10",
        "Effect of second-order terms on the center of mass",
        _ORDERS,
        (
            Claim(
                1,
                "largest final error of the center of mass, extended Kalman over second-order filter",
                "extended Kalman filter diverges; tremendous final errors",
                AtLeast(100.0),
                _excess(CENTER),
            ),
            Claim(
                1,
                "largest final error of the center of mass, extended Kalman filter",
                "tremendous final errors",
                AtLeast(50.0),
                lambda phase: _worst("linear", CENTER, phase),
                "%",
            ),
        ),
        {"fig_5_10": _errors(f"{_TITLE}: center of mass (figure 5-10)", (6, 7, 8), _ORDER_LABELS, 1e-3)},
    ),
    Entry(
        "fig_5_11",
        "Effect of second-order terms on the consistency function",
        _ORDERS,
        (
            Claim(
                1,
                "mean after 5 s, second-order filter",
                "follows central chi-square with 3 degrees of freedom (mean 3)",
                Between(2.5, 4.0),
                mean_nis("second", "rotation", 5.0),
            ),
            Claim(
                2,
                "orders of magnitude by which the largest value of the extended Kalman filter exceeds 3",
                "too large by seven orders of magnitude when applied forces are large",
                Between(6.5, 7.5),
                lambda phase: float(np.log10(_peak(phase["linear"], 0.0, np.inf) / 3.0)),
            ),
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
