"""Plots of a run, each described once: panels and marks from its signals, in units and colors.

Every function takes a `Source` and returns a `Plot`; `available_plots` names those that a source has the signals
for. Their figure numbers are those of the thesis.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from massprop_drake.display.detector_plots import (
    detection_timeline,
    failure_magnitude,
    fault_probabilities,
    likelihoods,
    margins,
)
from massprop_drake.display.filter_plots import (
    CENTER,
    DIAGONAL,
    PRODUCTS,
    center_of_mass,
    consistency,
    estimated_elements,
    innovations,
    inverse_inertia_diagonal,
    inverse_inertia_products,
    mass_innovations,
    mass_reciprocal,
    other_estimates,
    surroundings,
    thrust_factors,
)
from massprop_drake.display.motion_plots import (
    accelerometer_velocities,
    against_attitudes,
    against_positions,
    against_rates,
    against_velocities,
    attitude_error,
    clusters,
    forces,
    gyro_readings,
    jets,
    phase_plane,
    positions,
    propellant,
    rates,
    rates_estimated,
    torques,
    velocities,
)
from massprop_drake.display.plot_source import Source, plot
from massprop_drake.display.plot_source import source as source  # noqa: PLC0414 (for those who ask for plots)
from massprop_drake.display.spec import Line, Panel, Plot
from massprop_drake.display.style import COLORS
from massprop_drake.maths.signals import AGAINST, SYMBOLS, is_user_signal


def available_plots(run: Source) -> dict[str, Callable[[Source], Plot]]:
    """Returns the plots of a run by name, in the order to read them."""
    signals, vehicle = run.signals, run.vehicle
    beside = any(name.startswith(AGAINST) for name in signals)  # a simulation of a record's commands
    poses = vehicle.poses if beside else ()
    followed = "thrust_factor" in signals  # in a fixed frame
    detected = "likelihood" in signals
    probable = "none_probability" in signals and bool(np.isfinite(signals["none_probability"]).any())
    shown: tuple[tuple[Callable[[Source], Plot], object], ...] = (
        (accelerometer_velocities, "velocity" not in signals and vehicle.accelerometers),
        (rates, "rate" in signals),
        (gyro_readings, "rate" not in signals and vehicle.gyros),
        (rates_estimated, "rate" not in signals and not vehicle.gyros),
        (attitude_error, "attitude_error" in signals),
        (velocities, "velocity" in signals),
        (positions, "position_estimate" in signals),
        (clusters, run.clustered),
        (jets, True),
        (torques, "torque" in signals),
        (forces, "force" in signals),
        (phase_plane, "attitude_error" in signals),
        (against_positions, "position_estimate" in signals and any(pose.position_std is not None for pose in poses)),
        (against_attitudes, "attitude_estimate" in signals and any(pose.attitude_std is not None for pose in poses)),
        (against_rates, beside and vehicle.gyros),
        (against_velocities, beside and vehicle.accelerometers),
        (inverse_inertia_diagonal, estimated_elements(run, DIAGONAL)),
        (inverse_inertia_products, estimated_elements(run, PRODUCTS)),
        (center_of_mass, estimated_elements(run, CENTER)),
        (mass_reciprocal, "mass_nis" in signals),  # there is an accelerometer
        (consistency, True),
        (thrust_factors, followed),
        (surroundings, followed),
        (innovations, not followed and "rotation_innovation" in signals),
        (mass_innovations, not followed and "mass_innovation" in signals),
        (propellant, run.consistency is None),
        (fault_probabilities, detected and probable),
        (likelihoods, detected and not probable),
        (margins, detected and any(np.isfinite(signals[name]).any() for name in ("jet_margin", "cluster_margin"))),
        (failure_magnitude, detected),
        (detection_timeline, detected),
        (own_signals, _own_signal_names(run)),
    )
    return {draw.__name__: draw for draw, there in shown if there}


def own_signals(run: Source) -> Plot:
    """Plots signals of the user's own systems that nothing else shows, a panel for each."""
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
    """Returns names of the user's own signals that no other plot shows; long vectors are left out."""
    drawn = {f"{name}.estimate" for element in range(len(SYMBOLS)) for name in other_estimates(run, element)}
    return [
        name
        for name, values in run.signals.items()
        if is_user_signal(name)
        and not name.startswith(AGAINST)
        and name not in drawn
        and values.shape[1] <= _READABLE
        and np.isfinite(values).any()
    ]
