"""The one source of chance in a diagram."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydrake.systems.framework import InputPort, LeafSystem
from pydrake.systems.primitives import LinearSystem

from massprop_drake.maths.noise import Seed, normal_sample, varied


def noise_seed(period_s: float) -> LinearSystem:
    """A number in the context that varies the seed of all chance: zero, until `SetRandomContext` draws it.

    It is discrete state that its update leaves as it is: of a system made in Python, Drake draws no state.

    Args:
        period_s: sample period, s, so that no instant is added to those of the other systems.
    """
    one, none = np.eye(1), np.zeros((1, 0))
    seed = LinearSystem(A=one, B=none, C=one, D=none, time_period=period_s)
    seed.configure_random_state(covariance=one)
    seed.set_name("noise_seed")
    return seed


def seed_in(context: Any, port: InputPort, seed: int) -> Seed:
    """Seed of a run as a context has it.

    Args:
        context: of the system that has the port.
        port: connected to a `noise_seed`; where it is not, the seed is the run's own.
        seed: of the run.
    """
    return varied(seed, port.Eval(context)[0]) if port.HasValue(context) else seed


class NoiseSource(LeafSystem):
    """Serves independent standard normal numbers, the same ones however often they are asked for.

    Sample k of a stream is a pure function of the seed, the stream's name and k (see
    `massprop_drake.maths.noise`), so a log and a filter that read a port at the same time see the same
    value, and adding a stream changes no other.

    Ports:
        seed (in, 1): varies the seed, see `noise_seed`. Optional.
        <stream> (out, size): standard normal numbers of sample k = round(t / period).

    Timing: a port's value changes at k * period.

    Args:
        seed: of the run.
        period_s: sample period, s.
        streams: name and size of each stream.
    """

    def __init__(self, seed: int, *, period_s: float, streams: dict[str, int]):
        super().__init__()
        self.set_name("noise_source")
        port = self.DeclareVectorInputPort("seed", 1)
        needs = {self.time_ticket(), self.input_port_ticket(port.get_index())}
        for stream, size in streams.items():

            def calc(context: Any, output: Any, stream: str = stream, size: int = size) -> None:
                number = round(context.get_time() / period_s)
                output.SetFromVector(normal_sample(seed_in(context, port, seed), stream, number, size))

            self.DeclareVectorOutputPort(stream, size, calc, prerequisites_of_calc=needs)
