"""Figures 5-2 to 5-5: the sample maneuver itself."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from matplotlib.figure import Figure

from massprop_drake.inputs.scheduled import HandControllerWindow
from massprop_drake.maths.signals import AXES
from reproduction import words
from reproduction.claims import (
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
    Reading,
    Signals,
    reference,
)
from reproduction.drawing import curves, panels
from reproduction.entry import Entry
from reproduction.flights import HYBRID, SHORT_REQUESTS
from reproduction.measures import DEGREES, at, during, firings, maneuver_windows, orbiter, rms

_FLIGHT = {"flight": HYBRID}
_PAIRS = ((38.0, 40.0), (41.0, 43.0), (44.0, 46.0))  # two axes at once, the second of three seconds on


def _axis(window: HandControllerWindow) -> tuple[int, float]:
    """Returns index and sign of the axis that a window commands."""
    return AXES.index(window.axis[1]), 1.0 if window.axis[0] == "+" else -1.0


def _windows(controller: str) -> list[HandControllerWindow]:
    """Lists the maneuver's windows of a hand controller, rhc or thc."""
    return [window for window in maneuver_windows() if window.controller == controller]


def _second_half(run: Signals, window: HandControllerWindow) -> Array:
    """Returns the rates in a window's second half, deg/s, shape (m, 3)."""
    half = during(run, 0.5 * (window.start_s + window.end_s), window.end_s)
    result: Array = DEGREES * run["rate"][half]
    return result


def _largest_rate_error(phase: Phase) -> float:
    """Computes the largest error of the mean rate in a window's second half, deg/s."""
    run = phase["flight"]
    errors = []
    for window in _windows("rhc"):
        axis, sign = _axis(window)
        errors.append(abs(sign * _second_half(run, window)[:, axis].mean() - 0.5))
    return max(errors)


def _rate_step(phase: Phase) -> float:
    """Computes the median change of the rate by a firing of one sample, deg/s."""
    run = phase["flight"]
    change = DEGREES * np.abs(np.diff(run["rate"], axis=0)).max(axis=1)
    return float(np.median(change[change > 1e-3]))


def _off_axis_rates(run: Signals, controllers: str) -> list[float]:
    """Lists each window's largest mean rate about an axis not commanded, in its second half before 37 s, deg/s."""
    largest_rates = []
    for window in maneuver_windows():
        if window.start_s < 37.0 and window.controller in controllers:
            rates = np.abs(_second_half(run, window).mean(axis=0))
            others = np.delete(rates, _axis(window)[0]) if window.controller == "rhc" else rates
            largest_rates.append(float(others.max()))
    return largest_rates


def _largest_off_axis_rate(run: Signals, controllers: str = "rhc thc") -> float:
    """Computes the largest mean rate about an axis not commanded, over all windows, deg/s."""
    return max(_off_axis_rates(run, controllers))


def _speed(run: Signals) -> Array:
    """Computes the size of the angular rate, deg/s, shape (n,)."""
    result: Array = DEGREES * np.linalg.norm(run["rate"], axis=1)
    return result


def _speed_with_two_axes(phase: Phase) -> float:
    """Computes the mean size of the rate with two axes commanded, deg/s."""
    run = phase["flight"]
    return float(np.concatenate([_speed(run)[during(run, *pair)] for pair in _PAIRS]).mean())


def _largest_single_axis_rate(phase: Phase) -> float:
    """Computes the largest mean size of the rate in the last second of the six single rotations, deg/s."""
    run = phase["flight"]
    return max(
        float(_speed(run)[during(run, window.end_s - 1.0, window.end_s)].mean()) for window in _windows("rhc")[:6]
    )


def _velocity_gains(phase: Phase) -> list[float]:
    """Lists the velocity gained in each translation along its axis, ft/s."""
    run = phase["flight"]
    gains = []
    for window in _windows("thc"):
        axis, sign = _axis(window)
        ends = run["velocity"][[at(run, window.start_s), at(run, window.end_s)], axis]
        gains.append(sign * float(ends[1] - ends[0]))
    return gains


def _velocity_change_after(phase: Phase) -> float:
    """Computes the largest change of velocity in the 2 s after a translation, ft/s."""
    run = phase["flight"]
    changes = []
    for window in _windows("thc"):
        axis, _ = _axis(window)
        after = run["velocity"][during(run, window.end_s, window.end_s + 2.0), axis]
        changes.append(float(np.abs(after - after[0]).max()))
    return max(changes)


def _drift(phase: Phase) -> float:
    """Computes the largest velocity before the first translation, ft/s."""
    run = phase["flight"]
    return float(np.abs(run["velocity"][during(run, 0.0, 24.9)]).max())


def _on_times_s(phase: Phase, start_s: float = 0.0, end_s: float = 24.9) -> Array:
    """Returns the duration of each firing that begins within a time span, s, shape (m,)."""
    return firings(phase["flight"], start_s, end_s)[1]


def _count_firings(phase: Phase) -> float:
    """Counts the jet firings of the whole run."""
    return float(_on_times_s(phase, end_s=np.inf).size)


def _off_axis_torque(phase: Phase) -> float:
    """Computes the smallest RMS rate increment about other axes while jets fire, of all rotations, in gyro 1-sigmas."""
    run, vehicle = phase["flight"], orbiter()
    to_sigmas = (
        np.linalg.inv(vehicle.nominal.inertia) * vehicle.sample_period_s / np.sqrt(2.0 * vehicle.gyros[0].variance)
    )
    increments = []
    for window in _windows("rhc")[:6]:
        torque = run["torque"][during(run, window.start_s, window.end_s)]
        torque = torque[np.any(torque != 0.0, axis=1)]
        increments.append(rms(np.delete(torque @ to_sigmas, _axis(window)[0], axis=1)))
    return min(increments)


def _long_firings(phase: Phase) -> Array:
    """Returns the times at which firings of more than 640 ms begin, before 25 s, s."""
    starts, times = firings(phase["flight"], 0.0, 24.9)
    result: Array = starts[times > 0.65]
    return result


def _share_at_ends(phase: Phase) -> float:
    """Computes the share of long firings that begin within 0.2 s of where a rotation begins or ends."""
    ends = np.array([time for window in _windows("rhc") for time in (window.start_s, window.end_s)])
    return float(np.mean([np.abs(ends - start).min() < 0.2 for start in _long_firings(phase)]))


def _share_of_typical_firings(phase: Phase) -> float:
    """Computes the share of the firings before 25 s that last 80 to 640 ms."""
    return float(np.mean(_on_times_s(phase) < 0.65))


def _jets_on(run: Signals) -> Array:
    """Returns 1 where any jet is commanded, else 0, shape (n - 1,), without the last sample."""
    result: Array = (run["command"][:-1] > 0.0).any(axis=1).astype(float)
    return result


def _rms_force(start_s: float, end_s: float, phase: Phase) -> float:
    """Computes the RMS force per axis while jets fire, lbf."""
    run = phase["flight"]
    force = run["force"][during(run, start_s, end_s)]
    return rms(force[np.any(force != 0.0, axis=1)])


def _share_with_jets_on(phase: Phase) -> float:
    """Computes the share of samples with a jet on."""
    return float(_jets_on(phase["flight"]).mean())


def _share_usable(phase: Phase) -> float:
    """Computes the share of samples that remain after the gate of section 5.1."""
    run = phase["flight"]
    return float((_jets_on(run) * run["usable"][1:, 0]).mean())


def _propellant(phase: Phase) -> float:
    """Computes the propellant used, slug."""
    reciprocal = phase["flight"]["truth"][[0, -1], 9]
    return float(1.0 / reciprocal[0] - 1.0 / reciprocal[1])


def _off_whole_samples(phase: Phase) -> float:
    """Computes the largest distance of an on-time from a whole number of samples."""
    times = _on_times_s(phase, end_s=np.inf) / orbiter().sample_period_s
    return float(np.abs(times - np.round(times)).max())


def _axis_plots(
    signal: str, title: str, unit: str, *, scale: float = 1.0, step: bool = False
) -> Callable[[Phases], Figure]:
    """Makes a function that draws a signal of three axes; one that switches, of the first phase alone."""

    def component(axis: int) -> Callable[[Signals], Array]:
        """Makes a function that returns one component of the signal."""
        return lambda run: scale * run[signal][:, axis]

    def draw(phases: Phases) -> Figure:
        """Draws the picture from all phases."""
        figure, axes = panels(3, title)
        for axis, panel in enumerate(axes):
            curves(panel, phases[:1] if step else phases, {"flight": ""}, component(axis), step=step)
            panel.set_ylabel(f"{AXES[axis]}, {unit}")
        return figure

    return draw


# fmt: off
ENTRIES = (
    Entry("fig_5_2", "Angular velocity history", {**_FLIGHT, "short_requests": SHORT_REQUESTS}, (
            Claim(1, "mean rate in the second half of each window, largest distance from 0.5 deg/s",
                "the commanded axis reaches and holds 0.5 deg/s", Reading(AtMost(0.02), "holds: within our deadband"),
                _largest_rate_error, "deg/s",
                because=Because(
                    "a firing lasts whole samples of 80 ms, and half the rate change of a single one is {:.3f} deg/s "
                    "(median): a smaller error cannot be corrected, whatever the deadband of 0.02 deg/s",
                    (lambda phase: 0.5 * _rate_step(phase),))),
            Claim(2, "largest mean rate about an axis not commanded, before 37 s",
                "small residual rates about other axes, also in translations",
                Reading(AtMost(0.5 / 3.0), "small: at most a third of the commanded rate"),
                lambda phase: _largest_off_axis_rate(phase["flight"]), "deg/s",
                because=Because(
                    "a translation is requested for its whole 2 s, and rates swing in between. Requested for 0.4 s at "
                    "a time it is {:.3f} deg/s, and in the rotations alone {:.3f} deg/s",
                    (lambda phase: _largest_off_axis_rate(phase["short_requests"]),
                     lambda phase: _largest_off_axis_rate(phase["flight"], "rhc")))),
            Claim(2, "the same in the window where it is least",
                "some residual rotation in translations and about the other axes",
                Reading(AtLeast(8.7e-5), "some: more than the quantum of the gyro"),
                lambda phase: min(_off_axis_rates(phase["flight"], "rhc thc")), "deg/s"),
            Claim(3, "mean size of the rate with two axes commanded",
                "rates are largest from 37 s to 46 s, two axes at once",
                Reading(Between(0.68, 0.735), "0.5 deg/s about both, each within the deadband"), _speed_with_two_axes,
                "deg/s"),
            reference(3, "size of the rate in the six single rotations, last second, largest",
                "(at most about 0.55 deg/s before)", AtMost(0.55), _largest_single_axis_rate, "deg/s"),
        ),
        {"fig_5_2": _axis_plots("rate", "Angular velocity (figure 5-2)", "deg/s", scale=DEGREES)},
    ),
    Entry("fig_5_3", "Linear velocity history", _FLIGHT, (
            Claim(1, "velocity gained in 2 s of translation, least of the three",
                "about 0.5 ft/s² for 2 s on each axis", Reading(Between(0.9, 1.1), "about 0.5 ft/s²: rounds to it"),
                lambda phase: min(_velocity_gains(phase)), "ft/s"),
            Claim(1, "the same, largest of the three", "about 0.5 ft/s² for 2 s on each axis",
                Reading(Between(0.9, 1.1), "about 0.5 ft/s²: rounds to it"),
                lambda phase: max(_velocity_gains(phase)), "ft/s"),
            Claim(1, "change of that velocity in the 2 s after", "the new velocity is then kept",
                Reading(AtMost(0.0344), "kept: within a quantum of the accelerometer"), _velocity_change_after, "ft/s"),
            Claim(2, "largest velocity from the rotations alone, before 25 s", "some net translation during rotations",
                Reading(Between(0.01, 0.1), "some: 1 to 10 % of that of a translation"), _drift, "ft/s"),
        ),
        {"fig_5_3": _axis_plots("velocity", "Velocity of the center of mass (figure 5-3)", "ft/s")},
    ),
    Entry("fig_5_4", "Torque history", _FLIGHT, (
            Claim(1, "jet firings in 50 s", "118 jet firings commanded", Printed(118), _count_firings),
            reference(1, "jet firings in 50 s", "(of that order: 80 to 160)", Between(80, 160), _count_firings),
            Claim(2, "longest firing in the rotations before 25 s",
                "typical rotational firings lasted from 80 ms to 640 ms", Reading(Between(0.08, 0.64), "all of them"),
                lambda phase: float(_on_times_s(phase).max()), "s",
                because=Because(
                    "the jets selected here are not the thesis's, whose controller is not given: {:.0f} of {:.0f} "
                    "firings last longer than 640 ms, {:.0%} of them where a rotation begins or ends",
                    (lambda phase: float(_long_firings(phase).size), lambda phase: float(_on_times_s(phase).size),
                     _share_at_ends))),
            Claim(2, "share of the firings before 25 s that last 80 to 640 ms",
                "typical rotational firings lasted from 80 ms to 640 ms", words.TYPICALLY, _share_of_typical_firings),
            Claim(2, "longest firing in the translations", "some translation firings last 2 s", Near(2.0, 0.04),
                lambda phase: float(_on_times_s(phase, 24.9, 35.0).max()), "s"),
            Claim(2, "distance of on-times from whole samples", "multiples of 80 ms", AtMost(1e-6), _off_whole_samples,
                "samples"),
            Claim(3,
                "rate that torque about the other axes adds in a sample while jets fire, RMS over 1-sigma of the "
                "gyro, in the rotation where it is least", "off-axis torque in every rotation",
                Reading(AtLeast(1.0), "the gyro shows it"), _off_axis_torque),
        ),
        {"fig_5_4": _axis_plots("torque", "Torque about the center of mass (figure 5-4)", "ft-lbf", step=True)},
    ),
    Entry("fig_5_5", "Force history", _FLIGHT, (
            Claim(3, "RMS force per axis while jets fire, rotations before 25 s over translations",
                "noticeable residual force even during rotational maneuvers", words.NOTICEABLE,
                lambda phase: _rms_force(0.0, 24.9, phase) / _rms_force(25.0, 35.0, phase)),
            Claim(3, "the same", "small residual force", words.SMALL,
                lambda phase: _rms_force(0.0, 24.9, phase) / _rms_force(25.0, 35.0, phase)),
            Claim(4, "share of samples with a jet on",
                "much of the simulation time took place when the mass properties were observable", words.MUCH_OF,
                _share_with_jets_on),
            reference(4, "share of samples that remain after the gate of section 5.1", "(no number)", AtLeast(0.15),
                _share_usable),
            Claim(5, "propellant used", "the mass change was on the order of 5 slugs",
                Reading(Between(4.5, 5.5), "rounds to 5"), _propellant, "slug"),
        ),
        {"fig_5_5": _axis_plots("force", "Force (figure 5-5)", "lbf", step=True)},
    ),
)
# fmt: on
