"""The block `faults`: its priors, what they become, and the former keys of the detector that it replaces."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from command_probe import Massprop

from massprop_drake import InputError, Scenario, load_scenario
from massprop_drake.inputs import params
from massprop_drake.inputs.model import keys, yaml_text
from massprop_drake.inputs.renamed import RenamedWarning
from massprop_drake.inputs.scenario import FaultMode, FaultsBlock, HypothesesBlock, JetFaults, resolved
from massprop_drake.inputs.yaml import Document
from massprop_drake.maths.estimation.faults.declarations import Mode
from massprop_drake.maths.estimation.faults.hypothesis_filter import Params
from massprop_drake.maths.estimation.faults.priors import Priors

JETS = 44  # of the orbiter


def made(*overrides: str) -> Params:
    found: Params = params.detector_params(load_scenario("leak_named", list(overrides)))
    return found


def read(text: str) -> Scenario:
    document = Document(f"name: own\n{text}\n", "own.yaml")
    return resolved(document.data, document)


# ------------------------------------------------------------------------------- from key to filter


def test_the_block_has_the_priors_with_their_defaults_and_a_unit_each() -> None:
    block = FaultsBlock()
    assert set(FaultsBlock.model_fields) == {*Priors._fields, "slots", "modes", "jets"}
    assert Priors(*(getattr(block, name) for name in Priors._fields)) == Priors()
    for key in keys(FaultsBlock):
        assert (key.unit == "1/h") == key.name.endswith("per_hour"), key
    assert get_args(FaultMode) == tuple(mode.name.lower() for mode in Mode if mode != Mode.NONE)


@pytest.mark.parametrize("name", Priors._fields)
def test_every_prior_reaches_the_detector(name: str) -> None:
    value = 0.9 * getattr(Priors(), name)
    assert made(f"faults.{name}={value!r}").priors == Priors()._replace(**{name: value})


def test_all_jets_are_alike_by_default() -> None:
    found = made()
    assert found.priors == Priors()
    np.testing.assert_array_equal(found.allowed, np.ones(2 * JETS))
    np.testing.assert_array_equal(found.rates, np.ones(JETS))
    assert found.joint.places.n_force == 4


@pytest.mark.parametrize(
    ("modes", "more", "less"),
    [
        ("stuck_on", 1.0, 0.0),
        ("leak", 1.0, 0.0),
        ("stuck_off", 0.0, 1.0),
        ("loss", 0.0, 1.0),
        ("drifting", 1.0, 1.0),
        ("intermittent", 1.0, 1.0),
        ("leak, loss", 1.0, 1.0),
    ],
)
def test_modes_say_whether_a_jet_may_give_more_or_less(modes: str, more: float, less: float) -> None:
    of_all = made(f"faults.modes=[{modes}]").allowed
    np.testing.assert_array_equal(of_all, [more] * JETS + [less] * JETS)
    jet = load_scenario("leak_named").vehicle_data.jet_index("R4R")
    of_one = made(f"faults.jets={{R4R: {{modes: [{modes}]}}}}").allowed
    assert (of_one[jet], of_one[JETS + jet]) == (more, less)
    assert of_one.sum() == 2 * JETS - 2 + more + less


def test_a_jet_has_its_own_rate_in_terms_of_the_usual_one() -> None:
    jet = load_scenario("leak_named").vehicle_data.jet_index("R4R")
    found = made("faults={jet_per_hour: 0.002, jets: {R4R: {per_hour: 0.01}}}")
    assert found.rates[jet] == pytest.approx(5.0)
    assert np.delete(found.rates, jet) == pytest.approx(1.0)
    np.testing.assert_array_equal(found.allowed, np.ones(2 * JETS))


def test_slots_are_those_of_a_filter_whose_detector_is_on() -> None:
    for overrides, slots in (([], 4), (["faults.slots=2"], 2), (["faults.slots=2", "detector.kind=off"], 0)):
        assert params.joint_params(load_scenario("leak_named", overrides)).joint.places.n_force == slots


def test_a_resolved_scenario_is_read_back_as_it_is() -> None:
    scenario = load_scenario("leak_named", ["faults.jets={R4R: {modes: [leak]}}", "faults.drifting=0.1"])
    document = Document(yaml_text(scenario), "again.yaml")
    assert resolved(document.data, document) == scenario


def test_the_schema_lists_the_block(massprop: Massprop) -> None:
    done = massprop("check", "--schema", "scenario")
    assert done.status == 0
    assert "faults.false_per_hour" in done.out
    assert "faults.jets{}.modes" in done.out
    assert "detector (hypotheses).slots" not in done.out


# -------------------------------------------------------------------------------------- bad priors

REFUSED: dict[str, tuple[str, str]] = {
    "no probability": (
        "faults:\n  together: 1.5",
        "own.yaml, line 3: faults.together: input should be less than 1, got 1.5",
    ),
    "a negative share": ("faults:\n  start: -0.1", "line 3: faults.start: input should be greater than 0, got -0.1"),
    "no rate": ("faults:\n  jet_per_hour: 0", "line 3: faults.jet_per_hour: input should be greater than 0, got 0"),
    "shares above one": (
        "faults:\n  drifting: 0.3\n  full_thrust: 0.8",
        "line 4: faults.full_thrust: is with drifting 1.1 of all failures; both are shares, and sum to at most 1",
    ),
    "false as often as true": (
        "faults:\n  false_per_hour: 1e-3",
        "line 3: faults.false_per_hour: 0.001 is not below jet_per_hour, 0.001: ",
    ),
    "false as often as true, by the other key": (
        "faults:\n  jet_per_hour: 1e-7",
        "line 2: faults.false_per_hour: 1e-06 is not below jet_per_hour, 1e-07: ",
    ),
    "jets that fail at every sample": (
        "faults:\n  jet_per_hour: 2000",
        "line 2: faults: rates of 44 jets, payloads, 12 components and what is unknown sum to 8.8e+04 per hour, 1.96 "
        "events in a sample period of 0.08 s; at most one, 4.5e+04 per hour",
    ),
    "one jet that does": ("faults:\n  jets:\n    R4R: {per_hour: 5e4}", "line 2: faults: rates of 44 jets"),
    "readings that do": ("faults:\n  reading_per_hour: 4000", "line 2: faults: rates of 44 jets"),
    "payloads that do": ("faults:\n  payload_per_hour: 5e4", "line 2: faults: rates of 44 jets"),
    "pushes that do": ("faults:\n  unknown_per_hour: 5e4", "line 2: faults: rates of 44 jets"),
    "forces that change at every sample": (
        "faults:\n  change_per_hour: 9e4",
        "line 3: faults.change_per_hour: 9e+04 is 2 changes in a sample period of 0.08 s; at most one, 4.5e+04 per",
    ),
    "a jet without a mode": (
        "faults:\n  jets:\n    R4R:\n      modes: []",
        "line 5: faults.jets.R4R.modes: is empty; this field is required: name the fault modes that there may be",
    ),
    "no modes at all": ("faults:\n  modes: []", "line 3: faults.modes: is empty; this field is required: name the"),
    "no mode": ("faults:\n  modes: [leaks]", "line 3: faults.modes[0]: 'leaks' is not one of 'stuck_on', 'leak', "),
    "no jet": (
        "faults:\n  jets:\n    R4S: {per_hour: 0.1}",
        "line 4: faults.jets.R4S: 'R4S' is no jet of vehicle 'orbiter'; did you mean 'R4",
    ),
    "no key of a jet": ("faults:\n  jets:\n    R4R: {rate: 0.1}", "line 4: faults.jets.R4R.rate: unknown key"),
    "too many slots": ("faults:\n  slots: 17", "line 3: faults.slots: input should be less than or equal to 16, got"),
    "another filter": (
        "estimation: {filter: thesis}\nfaults:\n  drifting: 0.1",
        "line 4: faults.drifting: is a key of estimation.filter: joint, and the filter is thesis; leave it out",
    ),
}


@pytest.mark.parametrize(("text", "message"), REFUSED.values(), ids=REFUSED)
def test_what_is_no_prior_is_said_once_with_file_line_and_key(text: str, message: str) -> None:
    with pytest.raises(InputError, match=re.escape(message)) as raised:
        read(text)
    assert len(raised.value.problems) == 1


def test_shares_may_be_all_there_is() -> None:
    assert read("faults: {full_thrust: 0.9, drifting: 0.1}").faults.full_thrust == 0.9


def test_as_many_events_as_samples_are_too_many_for_a_slow_vehicle_first() -> None:
    often = {"jet_per_hour": 500.0, "payload_per_hour": 10.0}  # 22 010 an hour of 44 jets, 45 000 samples
    resolved({"faults": often})
    slow = {**load_scenario("leak_named").vehicle_data.model_dump(mode="json"), "sample_period_s": 0.2}
    with pytest.raises(InputError, match=r"2\.2e\+04 per hour, 1\.22 events in a sample period of 0\.2 s"):
        resolved({"faults": often, "vehicle": slow})


def test_a_program_is_told_the_same() -> None:
    with pytest.raises(ValueError, match=r"faults.jets.R4S\n.*'R4S' is no jet of vehicle 'orbiter'"):
        Scenario(vehicle="orbiter", faults={"jets": {"R4S": {}}})  # type: ignore[arg-type]
    assert Scenario(faults=FaultsBlock(jets={"R4R": JetFaults(modes=("leak",))})).faults.jets["R4R"].per_hour is None


def test_the_command_line_says_it_in_a_line(massprop: Massprop, tmp_path: Path) -> None:
    path = tmp_path / "own.yaml"
    path.write_text("name: own\nfaults:\n  together: 2\n", encoding="utf-8")
    done = massprop("check", path)
    assert done.status == 2
    assert "line 3: faults.together: input should be less than 1, got 2" in done.out
    assert "Traceback" not in done.out + done.err


# ------------------------------------------------------------------------------------- former keys

OLD = {"trigger_jet": 28.0, "trigger": 45.0, "lead": 6.0, "lead_nothing": 12.0, "jump": 100.0}
KIND = "detector.kind: multi_hypothesis is now hypotheses"
NO_EFFECT = (
    "detector.trigger_jet, detector.trigger, detector.lead, detector.lead_nothing, detector.jump have no effect any "
    "more: faults.false_per_hour says how sure a declaration is"
)
END = "version 0.4 will know the new name alone"


@pytest.mark.parametrize(
    ("block", "said", "slots"),
    [
        ({"kind": "multi_hypothesis"}, KIND, 4),
        (
            {"kind": "multi_hypothesis", **OLD, "slots": 2},
            f"{KIND}, detector.slots is now faults.slots, {NO_EFFECT}",
            2,
        ),
        ({"kind": "hypotheses", **OLD}, NO_EFFECT, 4),
        ({"kind": "hypotheses", "slots": 3}, "detector.slots is now faults.slots", 3),
        (
            {"lead": 8.0},
            "detector.lead has no effect any more: faults.false_per_hour says how sure a declaration is",
            4,
        ),
    ],
)
def test_former_keys_are_read_with_one_warning(block: dict[str, Any], said: str, slots: int, tmp_path: Path) -> None:
    path = tmp_path / "old.yaml"
    path.write_text(f"name: old\ndetector: {block}\n".replace("'", ""), encoding="utf-8")
    with pytest.warns(RenamedWarning) as caught:
        scenario = load_scenario(path)
    assert [str(warning.message) for warning in caught] == [f"{path}: {said}; {END}"]
    assert (scenario.detector, scenario.faults.slots) == (HypothesesBlock(), slots)
    with pytest.warns(RenamedWarning) as caught:
        same = Scenario(name="old", detector=block)  # type: ignore[arg-type]
    assert [str(warning.message) for warning in caught] == [f"scenario: {said}; {END}"]
    assert (same.detector, same.faults) == (scenario.detector, scenario.faults)


def test_an_old_file_is_named_by_its_users_line() -> None:
    with pytest.warns(RenamedWarning) as caught:
        Scenario(detector={"kind": "multi_hypothesis"})  # type: ignore[arg-type]
    assert caught[0].filename == __file__


@pytest.mark.parametrize("scenario", ["leak_named", "sample_maneuver"])
def test_the_former_kind_may_be_set(scenario: str) -> None:
    joint = ["estimation={filter: joint}", "rotation={}", "mass={}"]
    with pytest.warns(RenamedWarning) as caught:
        found = load_scenario(scenario, [*joint, "detector.kind=multi_hypothesis"])
    said = f"--set detector.kind=multi_hypothesis: multi_hypothesis is now hypotheses; {END}"
    assert [str(warning.message) for warning in caught] == [said]
    assert found.detector == HypothesesBlock()


def test_former_keys_may_be_set() -> None:
    with pytest.warns(RenamedWarning, match=r"detector\.slots is now faults\.slots; version") as caught:
        assert load_scenario("leak_named", ["detector.slots=2"]).faults.slots == 2
    assert len(caught) == 1
    with pytest.warns(RenamedWarning, match="is now hypotheses, detector.lead has no effect any more: ") as caught:
        found = load_scenario("leak_named", ["detector={kind: multi_hypothesis, lead: 7}"])
    assert (len(caught), found.detector) == (1, HypothesesBlock())


def test_a_bad_value_of_a_key_that_moved_is_named_with_its_line() -> None:
    with (
        pytest.warns(RenamedWarning),
        pytest.raises(InputError, match=r"own\.yaml, line 4: faults\.slots: input should be less .* 16, got 40"),
    ):
        read("detector:\n  kind: multi_hypothesis\n  slots: 40")


def test_a_key_that_moved_is_not_given_twice() -> None:
    with pytest.warns(RenamedWarning), pytest.raises(InputError, match=r"line 2: detector\.slots: unknown key"):
        read("detector: {kind: multi_hypothesis, slots: 2}\nfaults: {slots: 3}")


@pytest.mark.parametrize("block", [{"kind": "off", "trigger": 45.0}, {"kind": "cglr", "slots": 2}])
def test_other_kinds_have_no_former_keys(block: dict[str, Any]) -> None:
    named = "thesis" if block["kind"] == "cglr" else "joint"
    with pytest.raises(InputError, match="unknown key"):
        resolved({"estimation": {"filter": named}, "detector": block})


def test_leads_of_thrust_factors_stay() -> None:
    for block in ({"lead": 8.0, "lead_nothing": 9.0}, {"kind": "thrust_factors", "lead": 8.0, "lead_nothing": 9.0}):
        found = resolved({"vehicle": "air_bearing", "detector": block}).detector
        assert (found.kind, found.lead, found.lead_nothing) == ("thrust_factors", 8.0, 9.0)  # type: ignore[union-attr]
