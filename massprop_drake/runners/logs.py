"""What the estimation diagram's logs hold, taken apart; and its state, taken out and put back.

The same for every diagram that contains it: simulated runs and the replay of recorded telemetry.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from massprop_drake.errors import InputError
from massprop_drake.inputs import params
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.maths import mass_properties
from massprop_drake.maths.estimation.detectors.cglr import N_SUSPICION
from massprop_drake.results.summary import DETECTOR_STATUS, null_for_nan

Array = NDArray[np.float64]

# ports of the estimation diagram that are logged, where it has them
ESTIMATION = ("impulses", "rotation_report", "mass_report", "detector_report", "detector_memory")
RECENT = 256  # rows whose times a run keeps for the part that goes on from it


def estimation_signals(scenario: Scenario, logs: Mapping[str, Array]) -> dict[str, Array]:
    """The logged ports of the estimation diagram taken apart into named signals.

    Args:
        scenario: for the number of jets and the limits of convergence.
        logs: by port, a row per sample.
    """
    signals = _parts(logs["impulses"], angular_impulse=3, linear_impulse=3, usable=1, firing=1)
    rotation = logs["rotation_report"]
    mass = logs.get("mass_report", np.full((rotation.shape[0], 2), np.nan))  # without accelerometer
    signals["estimate"] = np.hstack([rotation[:, :9], mass[:, :1]])
    signals["standard_deviation"] = np.hstack([rotation[:, 9:18], np.sqrt(mass[:, 1:2])])
    limits = params.convergence_limits(scenario)
    good = mass_properties.converged_rows(signals["standard_deviation"], signals["estimate"], limits)
    signals["converged"] = good.astype(float)[:, None]
    signals |= _parts(
        rotation[:, 18:],
        rotation_innovation=3,
        rotation_nis=1,
        rotation_used=1,
        rotation_jump=1,
        coupling_subtracted=1,
    )
    if "mass_report" in logs:
        signals |= _parts(mass[:, 2:], mass_innovation=3, mass_nis=1, mass_used=1, mass_jump=1)
    if "detector_report" in logs:
        n_jets = len(scenario.vehicle_data.jets)
        signals |= _parts(logs["detector_report"], **DETECTOR_STATUS, likelihood=n_jets, failure_magnitude=n_jets)
        signals |= _parts(logs["detector_memory"][:, N_SUSPICION:], known_force=n_jets, known_force_variance=n_jets)
    return signals


def _parts(log: Array, **sizes: int) -> dict[str, Array]:
    edges = np.cumsum([0, *sizes.values()])
    return {name: log[:, start:end] for name, start, end in zip(sizes, edges, edges[1:], strict=False)}


def cycle_times(diagram: Any, cycles: int) -> dict[str, float | None]:
    """Mean time per cycle spent in the mathematics of each part, microseconds."""
    estimation = diagram.GetSubsystemByName("estimation")
    names = [system.get_name() for system in estimation.GetSystems()]
    estimators = [name for name in ("impulse_model", "rotation_estimator", "mass_estimator") if name in names]
    spent = sum(estimation.GetSubsystemByName(name).stopwatch.spent_s for name in estimators)
    selection = detector = None
    if diagram.HasSubsystemNamed("autopilot"):
        autopilot = diagram.GetSubsystemByName("autopilot")
        selection = 1e6 * autopilot.GetSubsystemByName("jet_selection").stopwatch.spent_s / cycles
    if "failure_detector" in names:
        detector = 1e6 * estimation.GetSubsystemByName("failure_detector").stopwatch.spent_s / cycles
    return {"estimators": 1e6 * spent / cycles, "detector": detector, "jet_selection": selection}


def saved_state(diagram: Any, context: Any) -> dict[str, list[list[float | None]]]:
    """The discrete state of every part of the estimation diagram, by name; NaN as None.

    Args:
        diagram: that contains the estimation diagram.
        context: the root context.
    """
    states = {}
    for system in diagram.GetSubsystemByName("estimation").GetSystems():
        own = system.GetMyContextFromRoot(context)
        groups = [own.get_discrete_state(index).CopyToVector() for index in range(own.num_discrete_state_groups())]
        if groups:
            states[system.get_name()] = [null_for_nan(group) for group in groups]
    return states


def restore_state(diagram: Any, context: Any, states: Mapping[str, Any], source: str) -> None:
    """Puts a saved state back.

    Args:
        diagram: that contains the estimation diagram.
        context: the root context, changed.
        states: as `saved_state` gives them.
        source: where they come from, for messages.

    Raises:
        InputError: when they are of another vehicle or other settings.
    """
    now = saved_state(diagram, context)
    for name in sorted(set(now) | set(states)):
        saved, here = _sizes(states.get(name)), _sizes(now.get(name))
        if saved != here:
            raise InputError(
                f"{source}: the saved state of {name} has sizes {saved or 'none'}, but these settings make it "
                f"{here or 'none'}; go on with the vehicle and the settings of that run"
            )
    estimation = diagram.GetSubsystemByName("estimation")
    for name, groups in states.items():
        own = estimation.GetSubsystemByName(name).GetMyMutableContextFromRoot(context)
        for index, group in enumerate(groups):
            own.SetDiscreteState(index, np.array(group, dtype=float))


def _sizes(groups: Any) -> list[int]:
    return [len(group) for group in groups] if isinstance(groups, list) else []
