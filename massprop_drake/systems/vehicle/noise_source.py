"""The one source of chance in a diagram."""

from __future__ import annotations

from typing import Any

from pydrake.systems.framework import LeafSystem

from massprop_drake.maths.noise import normal_sample


class NoiseSource(LeafSystem):
    """Serves independent standard normal numbers, the same ones however often they are asked for.

    Sample k of a stream is a pure function of the seed, the stream's name and k (see
    `massprop_drake.maths.noise`), so a log and a filter that read a port at the same time see the same
    value, and adding a stream changes no other.

    Ports:
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
        for stream, size in streams.items():

            def calc(context: Any, output: Any, stream: str = stream, size: int = size) -> None:
                output.SetFromVector(normal_sample(seed, stream, round(context.get_time() / period_s), size))

            self.DeclareVectorOutputPort(stream, size, calc, prerequisites_of_calc={self.time_ticket()})
