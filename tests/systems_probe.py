"""What the tests of systems ask of a system: its ports, its dependences, and one update."""

from __future__ import annotations

from typing import Any

from params_probe import PERIOD_S
from pydrake.systems.framework import InputPortIndex, LeafSystem, OutputPortIndex, System


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
    """The update at a sample, and the time of the next sample."""
    update(dut, context)
    context.SetTime(PERIOD_S * (round(context.get_time() / PERIOD_S) + 1))
