"""The noise source: the same numbers whenever they are asked for."""

from __future__ import annotations

import numpy as np
import pytest
from pydrake.common import RandomGenerator
from pydrake.systems.analysis import Simulator
from systems_probe import PERIOD_S, feedthrough, inputs, outputs

from massprop_drake.maths.noise import normal_sample
from massprop_drake.systems.vehicle.noise_source import NoiseSource, noise_seed


def _noise(dut: NoiseSource, stream: str, time_s: float) -> np.ndarray:
    context = dut.CreateDefaultContext()
    context.SetTime(time_s)
    return dut.GetOutputPort(stream).Eval(context)


def test_topology() -> None:
    dut = NoiseSource(0, period_s=PERIOD_S, streams={"gyro": 6, "acc1": 3})
    assert inputs(dut) == {"seed": 1}
    assert outputs(dut) == {"gyro": 6, "acc1": 3}
    assert feedthrough(dut) == {"gyro": {"seed"}, "acc1": {"seed"}}
    context = dut.CreateDefaultContext()
    assert context.num_discrete_state_groups() == 0
    assert context.num_continuous_states() == 0


def test_each_stream_serves_its_own_samples() -> None:
    dut = NoiseSource(5, period_s=PERIOD_S, streams={"gyro": 6, "acc1": 3})
    np.testing.assert_array_equal(_noise(dut, "gyro", 0.0), normal_sample(5, "gyro", 0, 6))
    np.testing.assert_array_equal(_noise(dut, "acc1", 7 * PERIOD_S), normal_sample(5, "acc1", 7, 3))


@pytest.mark.parametrize("sample", [0, 1, 63, 64, 65, 12345])
def test_the_sample_number_survives_the_rounding_of_its_time(sample: int) -> None:
    dut = NoiseSource(0, period_s=PERIOD_S, streams={"gyro": 6})
    expected = normal_sample(0, "gyro", sample, 6)
    for time_s in (sample * PERIOD_S, np.nextafter(sample * PERIOD_S, -1.0), np.nextafter(sample * PERIOD_S, 1e9)):
        np.testing.assert_array_equal(_noise(dut, "gyro", time_s), expected)


def test_the_value_depends_on_time_alone_and_not_on_the_order_of_asking() -> None:
    dut = NoiseSource(0, period_s=PERIOD_S, streams={"gyro": 6})
    context = dut.CreateDefaultContext()
    port = dut.GetOutputPort("gyro")
    forward = []
    for sample in range(5):
        context.SetTime(sample * PERIOD_S)
        forward.append(port.Eval(context))
        np.testing.assert_array_equal(port.Eval(context), forward[-1])  # asked again at the same time
    for sample in reversed(range(5)):
        context.SetTime(sample * PERIOD_S)
        np.testing.assert_array_equal(port.Eval(context), forward[sample])
    assert len({tuple(values) for values in forward}) == 5


def test_a_further_stream_changes_no_other() -> None:
    alone = NoiseSource(3, period_s=PERIOD_S, streams={"gyro": 6})
    accompanied = NoiseSource(3, period_s=PERIOD_S, streams={"acc1": 6, "gyro": 6, "acc2": 6})
    np.testing.assert_array_equal(_noise(alone, "gyro", 0.8), _noise(accompanied, "gyro", 0.8))


def test_what_is_drawn_varies_every_stream_and_zero_is_the_seed_itself() -> None:
    dut = NoiseSource(3, period_s=PERIOD_S, streams={"gyro": 6, "acc1": 3})
    context = dut.CreateDefaultContext()
    seed = dut.GetInputPort("seed")
    found = {}
    for drawn in (0.0, 0.5, np.nextafter(0.5, 1.0), 0.5):
        seed.FixValue(context, [drawn])
        found[drawn] = dut.GetOutputPort("gyro").Eval(context)
        assert found[drawn].tolist() == dut.GetOutputPort("gyro").Eval(context).tolist()
    np.testing.assert_array_equal(found[0.0], _noise(dut, "gyro", 0.0))
    assert len({tuple(values) for values in found.values()}) == 3  # a bit of it is another stream


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


def test_streams_and_seeds_differ() -> None:
    dut = NoiseSource(3, period_s=PERIOD_S, streams={"gyro": 6, "acc1": 6})
    other = NoiseSource(4, period_s=PERIOD_S, streams={"gyro": 6})
    assert not np.isclose(_noise(dut, "gyro", 0.8), _noise(dut, "acc1", 0.8)).any()
    assert not np.isclose(_noise(dut, "gyro", 0.8), _noise(other, "gyro", 0.8)).any()
