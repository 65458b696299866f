"""The noise source: the same numbers whenever they are asked for."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_array_equal
from pydrake.common import RandomGenerator
from pydrake.systems.analysis import Simulator
from systems_probe import PERIOD_S, feedthrough, inputs, output, outputs

from massprop_drake.maths.noise import normal_sample, vary_seed
from massprop_drake.systems import NoiseSource
from massprop_drake.systems.vehicle.noise_source import noise_seed


def test_each_stream_serves_its_own_samples_whenever_they_are_asked_for() -> None:
    dut = NoiseSource(5, period_s=PERIOD_S, streams={"gyro": 6, "acc1": 3})
    assert (inputs(dut), outputs(dut)) == ({"seed": 1}, {"gyro": 6, "acc1": 3})
    assert feedthrough(dut) == {"gyro": {"seed"}, "acc1": {"seed"}}
    context = dut.CreateDefaultContext()
    assert context.is_stateless()
    for number in (0, 1, 63, 64, 12345, 65, 0):  # which survives the rounding of its time
        for time_s in np.nextafter(number * PERIOD_S, [-1.0, number * PERIOD_S, 1e9]):
            context.SetTime(time_s)
            for stream, size in outputs(dut).items():
                assert_array_equal(output(dut, context, stream), normal_sample(5, stream, number, size))
    for drawn in (0.5, np.nextafter(0.5, 1.0), 0.0):  # a bit of it is another stream; zero is the seed itself
        found = output(dut, context, "gyro", seed=[drawn])
        assert_array_equal(found, normal_sample(vary_seed(5, drawn), "gyro", 0, 6))


def test_the_seed_of_a_context_is_drawn_and_stays() -> None:
    dut = noise_seed()
    simulator = Simulator(dut)
    context = simulator.get_mutable_context()
    assert dut.get_output_port().Eval(context) == [0.0]
    assert context.is_stateless()  # so that a diagram with it has the state of its body alone
    drawn = []
    for seed in (1, 2, 1):
        dut.SetRandomContext(context, RandomGenerator(seed))
        drawn.append(dut.get_output_port().Eval(context)[0])
    simulator.AdvanceTo(10 * PERIOD_S)
    assert dut.get_output_port().Eval(context) == drawn[2] == drawn[0] != drawn[1]
    dut.SetDefaultContext(context)
    assert dut.get_output_port().Eval(context) == [0.0]
