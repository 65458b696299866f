"""The cycle as one kernel is the cycle by its parts, bit for bit; compiled code is no part of it."""

from __future__ import annotations

from pathlib import Path

import pytest
from numpy.testing import assert_array_equal

from massprop_drake import estimate, load_scenario, simulate
from massprop_drake.inputs import params
from massprop_drake.maths.estimation import whole
from massprop_drake.runners import cycles, loop, recorded

FAILING = [
    "duration_s=9",
    "estimation.start=nominal",
    "estimation.std_fraction=0.05",
    "failures=[{kind: stuck_on, jet: R4R, start_s: 7}]",
]
CASES = {
    "stuck on": ("stuck_on_29", FAILING),
    "acted upon": ("stuck_on_29", [*FAILING, "detector.close_manifold=true", "autopilot.mass_properties=estimated"]),
    "no detector": ("sample_maneuver", ["duration_s=4", "detector.kind=off"]),
}


@pytest.mark.parametrize("case", CASES)
def test_one_kernel_gives_the_bits_of_the_parts(case: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    name, overrides = CASES[case]
    scenario = load_scenario(name, [*overrides, "execution.engine=loop"])
    one = simulate(scenario)
    one.save(tmp_path / "run", pictures=False, report=False)
    record = tmp_path / "run" / "telemetry.csv"
    read = estimate(record, scenario)
    for runner in (loop, recorded):
        monkeypatch.setattr(
            runner,
            "make_cycles",
            lambda _scenario, made, state=None: cycles.Stepped(made, state or cycles.cycle.initial_state(made)),
        )
    for whole_run, parts in ((one, simulate(scenario)), (read, estimate(record, scenario))):
        for signal in parts.signals:
            assert_array_equal(whole_run[signal], parts[signal], err_msg=signal)
    if case != "no detector":
        assert one["alarm"].any()
        assert one["known_force"].any() == (case == "stuck on")


def test_what_the_kernel_does_not_do_is_left_to_the_parts() -> None:
    for override, covered in {
        "duration_s=1": True,
        "detector.kind=off": True,
        "detector.kind=cusum": False,
        "sensors.combine.accelerometers=average": False,
        "estimation.thrust_uncertainty=0.01": False,
    }.items():
        made = params.estimation_params(load_scenario("sample_maneuver", [override]))
        assert whole.covers(made) == covered
