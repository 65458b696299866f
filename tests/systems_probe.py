"""What the tests of systems ask of a system: its ports, its dependences, and one update."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from params_probe import PERIOD_S
from pydrake.systems.framework import InputPortIndex, LeafSystem, OutputPortIndex, System

from massprop_drake import Run


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


def fed(dut: LeafSystem, run: Run, row: int, names: Sequence[str], context: Any = None) -> Any:
    """A context in which an estimator has a row of a run: its time, some signals, and the command until then.

    Args:
        dut: the estimator.
        run: to take it from.
        row: of it.
        names: of the signals, which are those of the ports.
        context: to change; None: a new one.
    """
    context = dut.CreateDefaultContext() if context is None else context
    for name in names:
        dut.GetInputPort(name).FixValue(context, run[name][row])
    before = run["command"][row - 1] if row else np.zeros_like(run["command"][0])
    dut.GetInputPort("jet_commands").FixValue(context, before)
    context.SetTime(run.time_s[row])
    return context


def give(dut: System, context: Any, **values: Any) -> None:
    """Fixes input ports."""
    for name, value in values.items():
        dut.GetInputPort(name).FixValue(context, np.asarray(value, dtype=float))


def output(dut: System, context: Any, name: str, **values: Any) -> Any:
    """What an output port says, with some inputs fixed before; asked twice, it says the same."""
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
