"""Plots of a run, each described once: panels and marks from its signals, in units and colors.

Every function takes a `Source` and returns a `Plot`; `available_plots` names those that a source has the signals
for. Their figure numbers are those of the thesis.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from massprop_drake.display import detector_plots, filter_plots, motion_plots
from massprop_drake.display.plot_source import Source, plot
from massprop_drake.display.plot_source import source as source  # noqa: PLC0414 (for those who ask for plots)
from massprop_drake.display.spec import Line, Panel, Plot
from massprop_drake.display.style import COLORS
from massprop_drake.maths.signals import AGAINST, SYMBOLS, is_user_signal


def available_plots(run: Source) -> dict[str, Callable[[Source], Plot]]:
    """Maps names of the plots that a run's signals allow to the functions that make them, in reading order."""
    signals, vehicle = run.signals, run.vehicle
    beside = any(name.startswith(AGAINST) for name in signals)  # a simulation of a record's commands
    poses = vehicle.poses if beside else ()
    placed = "position_estimate" in signals and any(pose.position_std is not None for pose in poses)
    turned = "attitude_estimate" in signals and any(pose.attitude_std is not None for pose in poses)
    followed = "thrust_factor" in signals  # in a fixed frame
    detected = "likelihood" in signals
    probable = "none_probability" in signals and bool(np.isfinite(signals["none_probability"]).any())
    separates = detected and any(np.isfinite(signals[name]).any() for name in ("jet_margin", "cluster_margin"))
    shown: tuple[tuple[Callable[[Source], Plot], object], ...] = (
        (motion_plots.accelerometer_velocities, "velocity" not in signals and vehicle.accelerometers),
        (motion_plots.rates, "rate" in signals),
        (motion_plots.gyro_readings, "rate" not in signals and vehicle.gyros),
        (motion_plots.rates_estimated, "rate" not in signals and not vehicle.gyros),
        (motion_plots.attitude_error, "attitude_error" in signals),
        (motion_plots.velocities, "velocity" in signals),
        (motion_plots.positions, "position_estimate" in signals),
        (motion_plots.clusters, run.clustered),
        (motion_plots.jets, True),
        (motion_plots.torques, "torque" in signals),
        (motion_plots.forces, "force" in signals),
        (motion_plots.phase_plane, "attitude_error" in signals),
        (motion_plots.against_positions, placed),
        (motion_plots.against_attitudes, turned),
        (motion_plots.against_rates, beside and vehicle.gyros),
        (motion_plots.against_velocities, beside and vehicle.accelerometers),
        (filter_plots.inverse_inertia_diagonal, filter_plots.estimated_elements(run, filter_plots.DIAGONAL)),
        (filter_plots.inverse_inertia_products, filter_plots.estimated_elements(run, filter_plots.PRODUCTS)),
        (filter_plots.center_of_mass, filter_plots.estimated_elements(run, filter_plots.CENTER)),
        (filter_plots.mass_reciprocal, "mass_nis" in signals),  # there is an accelerometer
        (filter_plots.consistency, True),
        (filter_plots.thrust_factors, followed),
        (filter_plots.surroundings, followed),
        (filter_plots.innovations, not followed and "rotation_innovation" in signals),
        (filter_plots.mass_innovations, not followed and "mass_innovation" in signals),
        (motion_plots.propellant, run.consistency is None),
        (detector_plots.fault_probabilities, detected and probable),
        (detector_plots.likelihoods, detected and not probable),
        (detector_plots.margins, separates),
        (detector_plots.failure_magnitude, detected),
        (detector_plots.detection_timeline, detected),
        (own_signals, _own_signal_names(run)),
    )
    return {draw.__name__: draw for draw, there in shown if there}


def own_signals(run: Source) -> Plot:
    """Plots the signals of the user's own systems that no other plot shows, one panel each."""
    panels = []
    for name in _own_signal_names(run):
        values = run.signals[name]
        components = range(values.shape[1])
        marks = [
            Line(run.time_s, values[:, at], COLORS[at % len(COLORS)], f"{at}" if len(components) > 1 else "")
            for at in components
        ]
        panels.append(Panel(name, "", tuple(marks)))
    return plot(run, "own_signals", "Signals of your own", panels)


_READABLE = 12  # components of a signal that are drawn, at the most


def _own_signal_names(run: Source) -> list[str]:
    """Returns names of the user's own signals that no other plot shows, without long vectors."""
    drawn = {
        f"{name}.estimate" for element in range(len(SYMBOLS)) for name in filter_plots.other_estimates(run, element)
    }
    return [
        name
        for name, values in run.signals.items()
        if is_user_signal(name)
        and not name.startswith(AGAINST)
        and name not in drawn
        and values.shape[1] <= _READABLE
        and np.isfinite(values).any()
    ]
