"""Linearization of diagrams whose state lies in several groups, which Drake's `Linearize` does not take."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from pydrake.autodiffutils import InitializeAutoDiff
from pydrake.systems.framework import Context, PortDataType, System
from pydrake.systems.primitives import LinearSystem

from massprop_drake.errors import InputError, suggestion
from massprop_drake.maths.linear_algebra import Array


def linearized(system: System, context: Context, inputs: Iterable[str], outputs: Iterable[str]) -> LinearSystem:
    """Linearizes a system about a context, with exact derivatives, between named input and output ports.

    Drake's `Linearize` takes state of one group. A vehicle whose jets lag, or whose sensors remember, has several:
    here they stand one after the other, in the order of the context.

    Args:
        system: that converts to AutoDiffXd, such as `diagrams.vehicle.build(scenario)` without quantizers.
        context: of it, in which inputs have values; those that are not named stay as they are.
        inputs: names of input ports, one after the other in u.
        outputs: names of output ports, one after the other in y.

    Returns:
        x' = A x + B u or, of a discrete system, x_k+1 = A x_k + B u_k, and y = C x + D u, of deviations from the
        context; with the period of the discrete updates.

    Raises:
        InputError: when there is no such port, it has no numbers or is named twice; when state is both continuous and
            discrete; or by the system, when it has no form for AutoDiffXd.
    """
    inputs = _require_ports("input", inputs, [system.get_input_port(k) for k in range(system.num_input_ports())])
    outputs = _require_ports("output", outputs, [system.get_output_port(k) for k in range(system.num_output_ports())])
    groups, continuous = context.num_discrete_state_groups(), context.num_continuous_states()
    if groups and continuous:
        raise InputError(
            f"'{system.get_name()}' has continuous and discrete state, which no linear system has; leave out "
            "plant.time_step: 0, or thrust lag and sensor memory"
        )
    converted = system.ToAutoDiffXd()
    at = converted.CreateDefaultContext()
    at.SetTimeStateAndParametersFrom(context)
    converted.FixInputPortsFrom(system, context, at)
    state = _state(context, groups)
    values = [system.GetInputPort(name).Eval(context) for name in inputs]
    varied = InitializeAutoDiff(np.concatenate([state, *values])).ravel()
    rest = _put_state(at, varied, groups)
    for name in inputs:
        port = converted.GetInputPort(name)
        port.FixValue(at, varied[rest : rest + port.size()])
        rest += port.size()
    n = state.size
    ahead = _gradient(_next_state_or_rate(converted, at, groups), varied.size)
    shown = [number for name in outputs for number in converted.GetOutputPort(name).Eval(at)]
    seen = _gradient(shown, varied.size)
    return LinearSystem(ahead[:, :n], ahead[:, n:], seen[:, :n], seen[:, n:], _period_s(system) if groups else 0.0)


def _require_ports(kind: str, given: Iterable[str], there: Sequence[Any]) -> list[str]:
    """Returns names of ports as a list; raises InputError for one that is absent, repeated or no vector."""
    if isinstance(given, str):
        raise InputError(f"{kind}s: must be a list of names, such as ['{given}']")
    names = list(given)
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise InputError(f"{kind} port '{twice}' is named twice; name it once")
    numbers = {port.get_name(): port.get_data_type() == PortDataType.kVectorValued for port in there}
    for name in names:
        if name not in numbers:
            raise InputError(f"there is no {kind} port '{name}'{suggestion(name, list(numbers))}")
        if not numbers[name]:
            raise InputError(f"{kind} port '{name}' has no numbers, which alone have derivatives")
    return names


def _state(context: Context, groups: int) -> Array:
    """Stacks continuous and discrete state of a context, shape (n,)."""
    discrete = [context.get_discrete_state(group).CopyToVector() for group in range(groups)]
    return np.concatenate([context.get_continuous_state_vector().CopyToVector(), *discrete])


def _put_state(at: Any, varied: Any, groups: int) -> int:
    """Writes a vector into the state of a context, and returns the number of its elements."""
    if not groups:
        count: int = at.num_continuous_states()
        at.get_mutable_continuous_state_vector().SetFromVector(varied[:count])
        return count
    begin = 0
    for group in range(groups):
        vector = at.get_mutable_discrete_state(group)
        vector.SetFromVector(varied[begin : begin + vector.size()])
        begin += vector.size()
    return begin


def _next_state_or_rate(converted: Any, at: Any, groups: int) -> Any:
    """Computes the time derivative of a continuous state, or the next value of a discrete one."""
    if not groups:
        return converted.EvalTimeDerivatives(at).get_vector().CopyToVector()
    updated = converted.EvalUniquePeriodicDiscreteUpdate(at)
    return np.concatenate([updated.get_vector(group).CopyToVector() for group in range(groups)])


def _gradient(numbers: Any, count: int) -> Array:
    """Returns the Jacobian of AutoDiff numbers, shape (k, count); zero where they depend on nothing."""
    rows = [one.derivatives() for one in numbers]
    return np.array([row if row.size else np.zeros(count) for row in rows]).reshape(-1, count)


def _period_s(system: System) -> float:
    """Returns the period of a system's discrete updates, s."""
    timing = system.GetUniquePeriodicDiscreteUpdateAttribute()
    return float(timing.period_sec())
