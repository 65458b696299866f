"""The file of a campaign: what is drawn and swept, and one message with file, line and field for what is wrong."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from massprop_drake import InputError
from massprop_drake.inputs.campaign_file import Dispersion, load_campaign, settings_of, with_settings
from massprop_drake.inputs.true_params import true_properties
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.maths.mass_properties import draw_body, is_possible_inertia
from massprop_drake.studies.campaign.plan import plan_cases

SOUND = """\
name: sound
base: sample_maneuver
cases: 20
draw:
  plant.thrust_dispersion: 0.01
  failures: [{kind: leak, jet: {choice: vernier}, start_s: {uniform: {low: 3, high: 4}}, force: 5.0}]
sweep: {detector.margin: [4, 6]}
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "study.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def drawn_at(u: float, spec: Any) -> dict[str, Any]:
    """The fields of the case whose coordinates are all the same."""
    values = {quantity.label: quantity.distribution.quantiles(np.array([u]))[0] for quantity in spec.quantities}
    return settings_of(spec, values)


def test_a_sound_file_says_what_is_drawn(tmp_path: Path, orbiter: Vehicle) -> None:
    spec = load_campaign(written(tmp_path, SOUND))
    assert [quantity.label for quantity in spec.quantities] == ["failures[0].jet", "failures[0].start_s"]
    verniers = [jet.designation for jet in orbiter.jets if jet.kind == "vernier"]
    assert list(spec.quantities[0].distribution.grid() or []) == verniers
    settings = drawn_at(0.0, spec)
    assert settings["plant.thrust_dispersion"] == 0.01
    assert settings["failures"] == [{"kind": "leak", "jet": verniers[0], "start_s": 3.0, "force": 5.0}]

    sets = ["cases=7", "set.duration_s=5", "limits.time_s=3.0", "sweep.detector.margin=[5]"]  # its own keys can be set
    spec = load_campaign(written(tmp_path, SOUND), sets)
    assert (spec.file.cases, spec.base.duration_s, spec.file.limits.time_s) == (7, 5, 3.0)
    assert spec.file.sweep == {"detector.margin": [5]}


def test_cases_are_computed_by_the_loop_unless_the_file_says_otherwise(tmp_path: Path) -> None:
    spec = load_campaign(written(tmp_path, SOUND))
    assert {case.scenario(spec.base, "sound").execution.engine for case in plan_cases(spec)} == {"loop"}
    assert load_campaign(written(tmp_path, SOUND), ["execution.engine=diagram"]).base.execution.engine == "diagram"
    continuous = load_campaign(written(tmp_path, SOUND), ["set.plant.time_step=0"])
    assert continuous.base.execution.engine == "diagram"  # which the loop does not cover
    with pytest.raises(InputError, match=r"execution\.engine: loop does not cover a continuous plant"):
        load_campaign(written(tmp_path, SOUND), ["set.plant.time_step=0", "execution.engine=loop"])


WRONG = [
    ("cases: 20", "cases: 20\nset: {execution.engine: loop}", "execution.engine: all cases are computed alike"),
    ("base: sample_maneuver", "base: sample_manuever", "line 2: base: .*did you mean 'sample_maneuver'"),
    ("cases: 20", "cases: 0", "line 3: cases: .*got 0"),
    ("cases: 20", "cases: 20\nmethod: sobel", "line 4: method: 'sobel' is not one of 'random', 'lhs', 'sobol'"),
    ("cases: 20", "cases: 20\nset: {detector.margn: 3}", "line 4: set.detector.margn: detector.margn: unknown key"),
    ("plant.thrust_dispersion: 0.01", "plant.thrust_disp: 0.01", "line 5: draw.plant.thrust_disp: .*unknown key"),
    ("0.01", "{gauss: {std: 0.1}}", "line 5: draw.plant.thrust_dispersion: there is no distribution 'gauss'"),
    ("0.01", "{uniform: {low: 2, high: 1}}", "line 5: draw.plant.thrust_dispersion: uniform: high must be above low"),
    ("plant.thrust_dispersion: 0.01", "plant.mass_properties: {mass_pct: 5}", "line 5: .*mass_pct: unknown key"),
    ("{choice: vernier}", "{choice: venier}", "line 6: draw.failures.0..jet: choice: 'venier' is neither"),
    ("kind: leak", "kind: {choice: [leek]}", "line 6: draw.failures: .*kind 'leek' is not one of"),
    ("sweep: {detector.margin: [4, 6]}", "sweep: {detector.margn: [4]}", "line 7: sweep.detector.margn.0.: .*unknown"),
    ("[4, 6]", "[4, x]", "line 7: sweep.detector.margin.1.: detector.margin: .*got 'x'"),
    ("sweep: {detector.margin: [4, 6]}", "sweep: {plant.thrust_dispersion: [0]}", "in two of set, draw and sweep"),
]


@pytest.mark.parametrize(("before", "after", "said"), WRONG)
def test_what_is_wrong_is_said_with_file_line_and_field(tmp_path: Path, before: str, after: str, said: str) -> None:
    assert SOUND.count(before) == 1
    path = written(tmp_path, SOUND.replace(before, after))
    with pytest.raises(InputError, match=said) as caught:
        load_campaign(path)
    assert str(path) in str(caught.value)


z = arrays.arrays(float, 10, elements=st.floats(-8.0, 8.0))
percent = st.floats(0.0, 100.0)


@settings(max_examples=50, derandomize=True, deadline=None, database=None)
@given(z=z, mass=percent, shift=st.floats(0.0, 100.0), moments=percent, axes=st.floats(0.0, 180.0))
def test_a_drawn_body_can_be(orbiter: Vehicle, z: Any, mass: float, shift: float, moments: float, axes: float) -> None:
    dispersion = Dispersion(mass_percent=mass, center_of_mass=shift, second_moments_percent=moments, axes_deg=axes)
    body = draw_body(orbiter.nominal, dispersion.spread, z)
    assert body.mass > 0.0
    assert is_possible_inertia(body.inertia)


def test_a_dispersion_is_of_the_size_that_it_says(tmp_path: Path, orbiter: Vehicle) -> None:
    dispersion = Dispersion(mass_percent=5.0, center_of_mass=0.3, second_moments_percent=3.0, axes_deg=1.0)
    nominal, spread = orbiter.nominal, dispersion.spread
    assert draw_body(nominal, spread, np.zeros(10)).mass == nominal.mass
    ones = draw_body(nominal, spread, np.array([1.0, 1.0, 0.0, 0.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0]))
    assert ones.mass == pytest.approx(1.05 * orbiter.nominal.mass)
    assert ones.center_of_mass - orbiter.nominal.center_of_mass == pytest.approx([0.3, 0.0, 0.0])
    np.testing.assert_allclose(ones.inertia, 1.03 * orbiter.nominal.inertia, rtol=1e-9)
    turned = draw_body(nominal, spread, np.array([0.0] * 9 + [1.0]))
    np.testing.assert_allclose(
        np.linalg.eigvalsh(turned.inertia), np.linalg.eigvalsh(orbiter.nominal.inertia), rtol=1e-12
    )
    text = "base: sample_maneuver\ncases: 3\ndraw: {plant.mass_properties: {mass_percent: 5}}\n"
    spec = load_campaign(written(tmp_path, text))
    assert len(spec.quantities) == 10
    case = with_settings(spec.base, drawn_at(0.5, spec))
    np.testing.assert_allclose(true_properties(case).vector(), true_properties(spec.base).vector(), rtol=1e-9)


def test_failures_have_the_sizes_of_their_kind_and_different_jets(tmp_path: Path, orbiter: Vehicle) -> None:
    text = """
base: sample_maneuver
cases: 2
draw:
  failures:
    - kind: {choice: [stuck_on, leak, degraded]}
      jet: {choice: all}
      start_s: 3
      force: {uniform: {low: 1, high: 400}}
    - {kind: stuck_off, jet: {choice: all}, start_s: 3}
"""
    spec = load_campaign(written(tmp_path, text))
    names = [jet.designation for jet in orbiter.jets]
    for u, own, jets in (
        (0.0, {"kind": "stuck_on"}, (0, 1)),
        (0.5, {"kind": "leak", "force": 200.5}, (22, 23)),
        (1.0 - 1e-9, {"kind": "degraded", "fraction": 0.0}, (43, 0)),  # all that it has is lost
    ):
        first, second = drawn_at(u, spec)["failures"]
        assert first == {"jet": names[jets[0]], "start_s": 3, **own}
        assert second["jet"] == names[jets[1]]
    # a drawn leak gives at most the thrust of its jet
    leak = "base: sample_maneuver\ncases: 2\ndraw: {failures: [{kind: leak, jet: L5D, start_s: 3, force: FORCE}]}\n"
    spec = load_campaign(written(tmp_path, leak.replace("FORCE", "{uniform: {low: 100, high: 400}}")))
    assert drawn_at(0.5, spec)["failures"][0]["force"] == 13.2
