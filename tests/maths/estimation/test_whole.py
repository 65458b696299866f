"""The cycle as one kernel is the cycle by its parts, bit for bit; compiled code is no part of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from massprop_drake import estimate, load_scenario, simulate
from massprop_drake.inputs import params
from massprop_drake.maths.estimation import whole
from massprop_drake.maths.kernels import Holder, fill, held, released
from massprop_drake.runners import cycles, loop, recorded
from massprop_drake.systems.layouts import ROTATION_REPORT

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
            "cycles",
            lambda _scenario, made, state=None: cycles.Stepped(made, state or cycles.cycle.initial_state(made)),
        )
    for whole_run, parts in ((one, simulate(scenario)), (read, estimate(record, scenario))):
        for signal in parts.signals:
            np.testing.assert_array_equal(whole_run[signal], parts[signal], err_msg=signal)
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


def test_a_row_is_filled_as_its_layout_packs_it_and_a_holder_gives_back_what_it_holds() -> None:
    fields = [np.arange(float(size)) if size > 1 else float(size) for size in (9, 9, 3, 3, 1, 1, 1, 1)]
    row = np.full(ROTATION_REPORT.size, np.nan)
    fill(row, fields)
    np.testing.assert_array_equal(row, ROTATION_REPORT.pack(fields))
    holder = held((1.0, 2.0), compile_it=False)
    assert isinstance(holder, Holder)
    assert released(holder) == (1.0, 2.0)
