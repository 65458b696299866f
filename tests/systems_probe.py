"""What the tests of systems ask of a system: its ports, its dependences, and one update."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from params_probe import PERIOD_S
from pydrake.systems.framework import InputPortIndex, LeafSystem, OutputPortIndex, System

from massprop_drake import Run, load_scenario, simulate

# the filter starts near the truth and soon settles
LEAKS = load_scenario(
    "leak_named",
    [
        "duration_s=2.7",
        "estimation={filter: joint, start: nominal, std_fraction: 0.001}",
        "joint={settled_after: 10, tank_fraction: 0, thrust_uncertainty: 0}",
        "failures=[{kind: leak, jet: L4D, start_s: 1.6, force: 40}]",
    ],
)


@cache
def leaked() -> Run:
    """A run of it; do not change its arrays."""
    return simulate(LEAKS)


def inputs(dut: System) -> dict[str, int]:
    """Names and sizes of the input ports, in order."""
    ports = [dut.get_input_port(InputPortIndex(index)) for index in range(dut.num_input_ports())]
    return {port.get_name(): port.size() for port in ports}


def outputs(dut: System) -> dict[str, int]:
    """Names and sizes of the output ports, in order."""
    ports = [dut.get_output_port(OutputPortIndex(index)) for index in range(dut.num_output_ports())]
    return {port.get_name(): port.size() for port in ports}


def feedthrough(dut: System) -> dict[str, set[str]]:
    """For each output port, the names of the inputs that it depends on at once."""
    return {
        out: {
            name
            for name in inputs(dut)
            if dut.HasDirectFeedthrough(dut.GetInputPort(name).get_index(), dut.GetOutputPort(out).get_index())
        }
        for out in outputs(dut)
    }


def update(dut: LeafSystem, context: Any) -> None:
    """The update at a sample: the discrete state becomes what the periodic event makes of it."""
    updated = dut.EvalUniquePeriodicDiscreteUpdate(context)
    # only now: taking the mutable state is what tells the context that it changes
    context.get_mutable_discrete_state().SetFrom(updated)


def advance(dut: LeafSystem, context: Any) -> None:
    """The update at a sample, where there is one, and the time of the next sample."""
    if dut.GetUniquePeriodicDiscreteUpdateAttribute() is not None:
        update(dut, context)
    context.SetTime(PERIOD_S * (round(context.get_time() / PERIOD_S) + 1))


def give(dut: System, context: Any, **values: Any) -> None:
    """Fixes input ports."""
    for name, value in values.items():
        dut.GetInputPort(name).FixValue(context, np.asarray(value, dtype=float))


def output(dut: System, context: Any, name: str, **values: Any) -> Any:
    """Value of an output port, with some inputs fixed before; asked twice, it is the same."""
    give(dut, context, **values)
    port = dut.GetOutputPort(name)
    said = port.Eval(context)
    np.testing.assert_array_equal(port.Eval(context), said)
    return said


def sample(dut: LeafSystem, context: Any, name: str, **values: Any) -> Any:
    """The same; the sample is then over."""
    said = output(dut, context, name, **values)
    advance(dut, context)
    return said
