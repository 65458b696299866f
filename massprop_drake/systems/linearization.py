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
    n_groups, continuous = context.num_discrete_state_groups(), context.num_continuous_states()
    if n_groups and continuous:
        raise InputError(
            f"'{system.get_name()}' has continuous and discrete state, which no linear system has; leave out "
            "plant.time_step: 0, or thrust lag and sensor memory"
        )
    converted = system.ToAutoDiffXd()
    point = converted.CreateDefaultContext()
    point.SetTimeStateAndParametersFrom(context)
    converted.FixInputPortsFrom(system, context, point)
    state = _stack_state(context, n_groups)
    values = [system.GetInputPort(name).Eval(context) for name in inputs]
    variables = InitializeAutoDiff(np.concatenate([state, *values])).ravel()
    begin = _put_state(point, variables, n_groups)
    for name in inputs:
        port = converted.GetInputPort(name)
        port.FixValue(point, variables[begin : begin + port.size()])
        begin += port.size()
    n = state.size
    dynamics = _gradient(_next_state_or_rate(converted, point, n_groups), variables.size)
    output_values = [number for name in outputs for number in converted.GetOutputPort(name).Eval(point)]
    gains = _gradient(output_values, variables.size)
    return LinearSystem(
        dynamics[:, :n], dynamics[:, n:], gains[:, :n], gains[:, n:], _period_s(system) if n_groups else 0.0
    )


def _require_ports(kind: str, port_names: Iterable[str], ports: Sequence[Any]) -> list[str]:
    """Returns port names as a list; raises InputError for one that is absent, repeated or no vector."""
    if isinstance(port_names, str):
        raise InputError(f"{kind}s: must be a list of names, such as ['{port_names}']")
    names = list(port_names)
    repeated = next((name for name in names if names.count(name) > 1), None)
    if repeated is not None:
        raise InputError(f"{kind} port '{repeated}' is named twice; name it once")
    numbers = {port.get_name(): port.get_data_type() == PortDataType.kVectorValued for port in ports}
    for name in names:
        if name not in numbers:
            raise InputError(f"there is no {kind} port '{name}'{suggestion(name, list(numbers))}")
        if not numbers[name]:
            raise InputError(f"{kind} port '{name}' has no numbers, which alone have derivatives")
    return names


def _stack_state(context: Context, n_groups: int) -> Array:
    """Stacks continuous and discrete state of a context, shape (n,)."""
    discrete = [context.get_discrete_state(group).CopyToVector() for group in range(n_groups)]
    return np.concatenate([context.get_continuous_state_vector().CopyToVector(), *discrete])


def _put_state(context: Any, values: Any, n_groups: int) -> int:
    """Writes a vector into the state of a context, and returns the number of its elements."""
    if not n_groups:
        count: int = context.num_continuous_states()
        context.get_mutable_continuous_state_vector().SetFromVector(values[:count])
        return count
    begin = 0
    for group in range(n_groups):
        vector = context.get_mutable_discrete_state(group)
        vector.SetFromVector(values[begin : begin + vector.size()])
        begin += vector.size()
    return begin


def _next_state_or_rate(system: Any, context: Any, n_groups: int) -> Any:
    """Computes the time derivative of a continuous state, or the next value of a discrete one."""
    if not n_groups:
        return system.EvalTimeDerivatives(context).get_vector().CopyToVector()
    updated = system.EvalUniquePeriodicDiscreteUpdate(context)
    return np.concatenate([updated.get_vector(group).CopyToVector() for group in range(n_groups)])


def _gradient(values: Any, n_variables: int) -> Array:
    """Returns the Jacobian of AutoDiff numbers, shape (k, n_variables); zero where they depend on nothing."""
    rows = [value.derivatives() for value in values]
    return np.array([row if row.size else np.zeros(n_variables) for row in rows]).reshape(-1, n_variables)


def _period_s(system: System) -> float:
    """Returns the period of a system's discrete updates, s."""
    timing = system.GetUniquePeriodicDiscreteUpdateAttribute()
    return float(timing.period_sec())
