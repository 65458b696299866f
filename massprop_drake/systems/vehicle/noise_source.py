"""Single source of random numbers in a diagram."""

from __future__ import annotations

from typing import Any

from pydrake.systems.framework import (
    BasicVector_,
    Diagram,
    DiagramBuilder,
    InputPort,
    LeafSystem_,
    NumericParameterIndex,
)
from pydrake.systems.primitives import ConstantVectorSource, MultilayerPerceptron, PerceptronActivationType

from massprop_drake.maths.kernels import value_of
from massprop_drake.maths.noise import Seed, normal_sample, vary_seed
from massprop_drake.systems.caching import declare_output
from massprop_drake.systems.scalars import float_class, template


@template
def SeedLatch_(T: Any) -> Any:  # noqa: N802 (Drake's name of a template)
    """Makes the class of latches for a scalar type T, which pass a number on when parameters change.

    A perceptron's output counts as new at every time, and would make anew at every sample all that is drawn before a
    run. To draw a context tells all of its systems that parameters have changed, so the latch waits for that.
    """

    class Latch(LeafSystem_[T]):
        """Passes a number on when parameters of the context change; its own parameter serves to notice that."""

        def _construct(self, converter: Any = None) -> None:
            """Declares the port, and the output that passes it on when parameters change."""
            LeafSystem_[T].__init__(self, converter)
            port = self.DeclareVectorInputPort("drawn", 1)
            ticket = self.numeric_parameter_ticket(
                NumericParameterIndex(self.DeclareNumericParameter(BasicVector_[T](1)))
            )
            declare_output(self, "seed", 1, port.Eval, {ticket})

        def _construct_copy(self, other: Any, converter: Any = None) -> None:
            """Constructs the latch from one of another scalar type."""
            Latch._construct(self, converter=converter)

    return Latch


def noise_seed() -> Diagram:
    """Makes a source of the number that varies the seed of all draws: zero, until `SetRandomContext` draws it.

    It is the parameter of a perceptron with one weight. Of a system made in Python, Drake draws neither state nor
    parameters, and a perceptron is its one system that draws a parameter, so that no state is added to a diagram.
    Set it by `SetRandomContext` or `SetDefaultContext` alone, of this diagram or of one around it, see `SeedLatch_`.
    """
    builder = DiagramBuilder()
    one = builder.AddNamedSystem("one", ConstantVectorSource([1.0]))
    drawn = builder.AddNamedSystem(
        "drawn", MultilayerPerceptron(layers=[1, 1], activation_type=PerceptronActivationType.kIdentity)
    )
    latch = builder.AddNamedSystem("latch", SeedLatch_[float]())
    builder.Connect(one.get_output_port(), drawn.get_input_port())
    builder.Connect(drawn.get_output_port(), latch.get_input_port())
    builder.ExportOutput(latch.get_output_port(), "seed")
    seed = builder.Build()
    seed.set_name("noise_seed")
    return seed


def run_seed(context: Any, port: InputPort, seed: int) -> Seed:
    """Returns the run's seed combined with the number at a port that varies it; unconnected: the seed alone.

    Args:
        context: of the system that has the port.
        port: connected to a `noise_seed`; where it is not, the seed is the run's own.
        seed: of the run.
    """
    return vary_seed(seed, value_of(port.Eval(context)[0])) if port.HasValue(context) else seed


@template
def NoiseSource_(T: Any) -> Any:  # noqa: N802 (Drake's name of a template)
    """Makes the class of noise sources for a scalar type T, see `NoiseSource`."""

    class Streams(LeafSystem_[T]):
        """Serves independent standard normal numbers, the same ones however often they are read.

        Sample k of a stream is a pure function of the seed, the stream's name and k (see
        `massprop_drake.maths.noise`), so a log and a filter that read a port at the same time see the same
        value, and adding a stream changes no other.

        Ports:
            seed (in, 1): varies the seed, see `noise_seed`. Optional.
            <stream> (out, size): standard normal numbers of sample k = round(t / period).

        Timing: a port's value changes at k * period.

        Scalars: float, AutoDiffXd and Expression; the numbers have no derivatives, and time must be a number.

        Args:
            seed: of the run.
            period_s: sample period, s.
            streams: name and size of each stream.
        """

        def _construct(self, seed: int, *, period_s: float, streams: dict[str, int], converter: Any = None) -> None:
            """Declares an output for each stream: its name, and how many numbers it has."""
            LeafSystem_[T].__init__(self, converter)
            self.set_name("noise_source")
            self._made = seed, period_s, streams
            port = self.DeclareVectorInputPort("seed", 1)
            needs = {self.time_ticket(), port.ticket()}
            for stream, size in streams.items():

                def draw_sample(context: Any, stream: str = stream, size: int = size) -> Any:
                    """Returns the standard normal numbers of a stream at a context's sample, shape (size,)."""
                    number = round(value_of(context.get_time()) / period_s)
                    return normal_sample(run_seed(context, port, seed), stream, number, size)

                declare_output(self, stream, size, draw_sample, needs)

        def _construct_copy(self, other: Any, converter: Any = None) -> None:
            """Constructs the noise source from one of another scalar type."""
            seed, period_s, streams = other._made
            Streams._construct(self, seed, period_s=period_s, streams=streams, converter=converter)

    return Streams


NoiseSource: Any = float_class(NoiseSource_, "NoiseSource")
