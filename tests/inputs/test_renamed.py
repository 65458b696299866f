"""Names of earlier versions: accepted with one warning that says what to write instead."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from command_probe import Massprop

from massprop_drake import InputError, Scenario, load_scenario, load_vehicle
from massprop_drake.inputs.estimation_blocks import HypothesesBlock
from massprop_drake.inputs.renamed import RenamedWarning
from massprop_drake.inputs.scenario import resolve_scenario
from massprop_drake.inputs.yaml import Document

LANDED = Path(__file__).parents[1] / "data" / "landed_0_1"
END = "version 0.4 will know the new name alone"


def test_old_keys_of_files_are_read_with_one_warning_each(massprop: Massprop) -> None:
    with pytest.warns(RenamedWarning) as caught:
        vehicle = load_vehicle(LANDED / "cube.yaml")
    assert [solid.color for solid in vehicle.shape] == ["#c2503c", "#5b6470"]
    assert [str(warning.message) for warning in caught] == [f"{LANDED / 'cube.yaml'}: colour is now color; {END}"]
    with pytest.warns(RenamedWarning) as caught:
        scenario = load_scenario(LANDED / "turned_cube.yaml")
    assert scenario.sensors.quantizer_phase == "equal"
    places = [str(warning.message).partition(": ")[0] for warning in caught]
    assert places == [str(LANDED / "turned_cube.yaml"), str(LANDED / "cube.yaml")]
    with pytest.warns(RenamedWarning) as caught:  # a vehicle inside a scenario is named in the same warning
        scenario = load_scenario(LANDED / "run")
    (warning,) = caught
    assert "colour is now color, quantiser_phase is now quantizer_phase" in str(warning.message)
    done = massprop("check", LANDED / "turned_cube.yaml", LANDED / "cube.yaml", "--json")
    assert done.status == 0
    assert [line.partition(": ")[0] for line in done.err.splitlines()] == ["massprop", "massprop"]


OLD = {"trigger_jet": 28.0, "trigger": 45.0, "lead": 6.0, "lead_nothing": 12.0, "jump": 100.0}
KIND = "detector.kind: multi_hypothesis is now hypotheses"
MEANT = "faults.false_per_hour says how sure a declaration is"
NO_EFFECT = (
    "detector.trigger_jet, detector.trigger, detector.lead, detector.lead_nothing, detector.jump have no effect any "
    f"more: {MEANT}"
)


@pytest.mark.parametrize(
    ("block", "said", "slots"),
    [
        (
            {"kind": "multi_hypothesis", **OLD, "slots": 2},
            f"{KIND}, detector.slots is now faults.slots, {NO_EFFECT}",
            2,
        ),
        ({"lead": 8.0}, f"detector.lead has no effect any more: {MEANT}", 4),
    ],
)
def test_former_keys_of_the_detector_are_read(block: dict[str, Any], said: str, slots: int, tmp_path: Path) -> None:
    path = tmp_path / "old.yaml"
    path.write_text(f"name: old\ndetector: {block}\n".replace("'", ""), encoding="utf-8")
    with pytest.warns(RenamedWarning) as caught:
        scenario = load_scenario(path)
    assert [str(warning.message) for warning in caught] == [f"{path}: {said}; {END}"]
    assert (scenario.detector, scenario.faults.slots) == (HypothesesBlock(), slots)
    with pytest.warns(RenamedWarning) as caught:
        same = Scenario(name="old", detector=block)  # type: ignore[arg-type]
    assert [(str(warning.message), warning.filename) for warning in caught] == [(f"scenario: {said}; {END}", __file__)]
    assert (same.detector, same.faults) == (scenario.detector, scenario.faults)


def test_former_keys_of_the_detector_may_be_set() -> None:
    joint = ["estimation={filter: joint}", "rotation={}", "mass={}"]
    with pytest.warns(RenamedWarning) as caught:
        found = load_scenario("sample_maneuver", [*joint, "detector.kind=multi_hypothesis"])
    said = f"--set detector.kind=multi_hypothesis: multi_hypothesis is now hypotheses; {END}"
    assert [str(warning.message) for warning in caught] == [said]
    assert found.detector == HypothesesBlock()
    with pytest.warns(RenamedWarning, match=r"detector\.slots is now faults\.slots; version"):
        assert load_scenario("leak_named", ["detector.slots=2"]).faults.slots == 2


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            "sensors:\n  quantiser_phase: equal\n  quantizer_phase: equal\n",
            r"line 3: sensors\.quantizer_phase: the key appears twice, first in line 2",
        ),
        ("colour: red\n", "line 1: colour: unknown key"),  # an old word elsewhere is no old key
        (
            "detector:\n  kind: multi_hypothesis\n  slots: 40\n",
            r"line 3: faults\.slots: input should be less .* 16, got 40",
        ),
        ("detector: {kind: multi_hypothesis, slots: 2}\nfaults: {slots: 3}\n", r"line 1: detector\.slots: unknown key"),
    ],
)
@pytest.mark.filterwarnings("ignore::massprop_drake.inputs.renamed.RenamedWarning")
def test_a_bad_value_under_an_old_key_is_named_with_its_line(text: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        resolve_scenario((document := Document(text, "own.yaml")).data, document)
