"""The plain loop: the diagram's numbers without the diagram, or a reason why not."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from massprop_drake import InputError, Run, load_scenario, simulate
from massprop_drake.inputs.scenario import bundled_scenarios
from massprop_drake.maths.linear_algebra import NotPositiveDefiniteError
from massprop_drake.runners.loop import Loop

NOT_COMPARED = {"timing", "provenance"}
# what no bundled scenario turns on, and what happens later than their first seconds
VARIANTS = {
    "estimated": ("stuck_on_29", "duration_s=12", "autopilot.mass_properties=estimated"),
    "joint_estimated": ("orbiter_maneuver", "duration_s=5", "autopilot.mass_properties=estimated"),
    "manifold": ("stuck_on_29", "duration_s=14", "detector.close_manifold=true"),
    "noisy": (
        "sample_maneuver",
        "duration_s=5",
        "plant.thrust_transient=vehicle",
        "plant.disturbance={torque_std: [1, 1, 1], force: [1, 0, 0]}",
        "sensors.errors=[{sensor: gyro, bias_random_walk: 1.0e-7, noise_std: 2.0e-6}, {sensor: acc2, noise_std: 0.01, "
        "bias: [1.0e-3, 0, 0], delay_samples: 1, vibration: [{frequency_hz: 9, amplitude: [1, 0, 0]}]}]",
    ),
    "vibrating": (
        "sample_maneuver",
        "duration_s=2",
        "sensors.errors=[{sensor: gyro, vibration: [{frequency_hz: 9, amplitude: [1.0e-4, 0, 0]}]}]",
    ),
    "jump": ("payload_release", "duration_s=6", "jumps[0].time_s=3"),
    "heavy": (  # beyond twice the mass at the start
        "free_flyer_maneuver",
        "duration_s=6",
        "jumps=[{kind: dock, time_s: 1, mass: 9, position: [0.1, 0.2, -0.1], "
        "inertia: [[0.5, 0, 0], [0, 0.5, 0], [0, 0, 0.5]]}]",
    ),
    "on a floor": (
        "air_bearing_pulses",
        "duration_s=8",
        "jumps=[{kind: dock, time_s: 1, mass: 2, position: [0.1, 0.05, 0.3], "
        "inertia: [[0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]]}]",
    ),
    "unobserved": (
        "sample_maneuver",
        "duration_s=4",
        "vehicle.preferred_accelerometer=null",
        "vehicle.accelerometers=[]",
        "detector.kind=off",
    ),
}


def both(name: str, *overrides: str) -> tuple[Run, Run]:
    """A case by either engine."""
    cases = [load_scenario(name, [*overrides, f"execution.engine={engine}"]) for engine in ("diagram", "loop")]
    found = [simulate(case, look_back=False) for case in cases]
    return found[0], found[1]


def require_same(diagram: Run, loop: Run) -> None:
    """Bit for bit: every signal, the summary, the saved state."""
    assert list(loop.signals) == list(diagram.signals)
    np.testing.assert_array_equal(loop.time_s, diagram.time_s)
    for name in diagram.signals:
        np.testing.assert_array_equal(loop[name], diagram[name], err_msg=name)
    summaries = [{k: v for k, v in run.summary.items() if k not in NOT_COMPARED} for run in (diagram, loop)]
    assert summaries[0] == summaries[1]


@pytest.mark.parametrize("name", [name for name in bundled_scenarios() if load_scenario(name).plant.kind == "rigid"])
def test_every_bundled_scenario_gives_the_diagrams_bits(name: str) -> None:
    require_same(*both(name, "duration_s=2"))


@pytest.mark.parametrize("name", VARIANTS)
def test_what_no_bundled_scenario_turns_on_gives_the_diagrams_bits(name: str) -> None:
    require_same(*both(*VARIANTS[name]))


AT_ONCE = {
    "stuck": ("stuck_on_29", "duration_s=14"),
    "jump": VARIANTS["jump"],
    "scheduled": ("jet_pulses", "duration_s=4"),
}


@pytest.mark.parametrize("name", AT_ONCE)
def test_the_kernel_with_vehicle_autopilot_and_estimation_gives_their_bits(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    case = load_scenario(AT_ONCE[name][0], [*AT_ONCE[name][1:], "execution.engine=loop"])
    apart = simulate(case, look_back=False)
    monkeypatch.setattr(Loop, "_covered", lambda loop: loop._known)  # else of compiled runs alone
    together = simulate(case, watch=lambda moment: None, look_back=False)  # sample by sample
    require_same(apart, together)
    assert apart.summary["timing"]["cycle_us"]["estimators"] > 0.0
    assert together.summary["timing"]["cycle_us"]["estimators"] is None


@pytest.mark.filterwarnings("ignore:invalid value encountered in sqrt")
def test_what_cannot_go_on_is_said_with_its_time_by_that_kernel(monkeypatch: pytest.MonkeyPatch) -> None:
    case = load_scenario("sample_maneuver", ["duration_s=4", "execution.engine=loop"])
    monkeypatch.setattr(Loop, "_covered", lambda loop: loop._known)
    loop = Loop(case)
    loop.advance(1.0)
    state = loop._whole.holder.value  # type: ignore[union-attr]
    lost = state.filter.rotation._replace(covariance=-np.eye(9))
    loop._whole.holder.value = state._replace(filter=state.filter._replace(rotation=lost))  # type: ignore[union-attr]
    with pytest.raises(NotPositiveDefiniteError, match=r"^estimator: .* at t = ([0-9.]+) s") as failed:
        loop.advance(4.0)
    assert failed.value.time_s > 1.0
    assert loop.logged == round(failed.value.time_s / 0.08)  # none of that sample
    assert loop.moment().time_s == pytest.approx(failed.value.time_s - 0.08)


def test_the_saved_state_is_the_same(tmp_path: Path) -> None:
    saved = []
    for run in both("stuck_on_29", "duration_s=2"):
        run.save(tmp_path / "run", pictures=False, report=False)
        saved.append(json.loads((tmp_path / "run" / "filter_state.json").read_text()))
    assert saved[0] == saved[1]


def test_logs_may_be_emptied_at_any_row() -> None:
    case = load_scenario(*VARIANTS["noisy"][:1], [*VARIANTS["noisy"][1:], "duration_s=30", "execution.engine=loop"])
    whole, parts = Loop(case), Loop(case)
    whole.advance(30.0)
    pieces = []
    for reached_s in (0.0, 10.0, 20.41, 20.49, 30.0):  # row 255 is the last of a block, 256 the next one's first
        parts.advance(reached_s)
        assert 0.0 <= reached_s - parts.moment().time_s < 0.08
        pieces.append(parts.emptied())
        assert parts.logged == 0
    assert whole.logged == 376
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
