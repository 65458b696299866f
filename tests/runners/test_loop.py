"""The plain loop: the diagram's numbers without the diagram, or a reason why not."""

from __future__ import annotations

import numpy as np
import pytest

from massprop_drake import InputError, load_scenario, simulate
from massprop_drake.runners.loop import Loop


def test_logs_may_be_emptied_at_any_row() -> None:
    noise = "sensors.errors=[{sensor: gyro, noise_std: 2.0e-6}, {sensor: acc2, delay_samples: 1}]"
    case = load_scenario("sample_maneuver", ["duration_s=22", "execution.engine=loop", noise])
    whole, parts = Loop(case), Loop(case)
    whole.advance(22.0)
    pieces = []
    for reached_s in (0.0, 10.0, 20.41, 20.49, 22.0):  # row 255 is the last of a block, 256 the next one's first
        parts.advance(reached_s)
        assert 0.0 <= reached_s - parts.moment().time_s < 0.08
        pieces.append(parts.emptied())
        assert parts.logged == 0
    assert whole.logged == 276
    for name, values in whole.emptied().items():
        np.testing.assert_array_equal(np.concatenate([piece[name] for piece in pieces]), values, err_msg=name)


def test_a_watcher_sees_the_same() -> None:
    seen: dict[str, list[object]] = {}
    for engine in ("diagram", "loop"):
        moments = seen.setdefault(engine, [])
        case = load_scenario("stuck_on_29", ["duration_s=1", f"execution.engine={engine}"])
        simulate(case, watch=lambda moment, moments=moments: moments.append(list(moment)))  # type: ignore[misc]
    assert len(seen["loop"]) == 12
    for one, other in zip(seen["diagram"], seen["loop"], strict=True):
        for left, right in zip(one, other, strict=True):  # type: ignore[call-overload]
            np.testing.assert_array_equal(left, right)


def test_a_continuous_plant_is_refused_with_the_reason() -> None:
    with pytest.raises(InputError, match=r"execution\.engine: loop does not cover a continuous plant"):
        load_scenario("sample_maneuver", ["plant.time_step=0", "execution.engine=loop"])
