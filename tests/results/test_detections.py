"""The mode of a fault, and its words."""

from __future__ import annotations

from typing import Any

import pytest

from massprop_drake.results.detections import JUMP, DetectionRecord, fault_mode, in_words

SI = {"force": "N", "mass": "kg", "length": "m"}
JET = DetectionRecord(
    10.0, 11.0, "jet_on", 3, "T7", "jet", 0.05, 0.0012, 50.0, 2, jets=("T7",), thrust=1.0
)  # fmt: skip
PAYLOAD = DetectionRecord(10.0, 11.0, JUMP, None, None, None, None, None, 50.0, 2)


@pytest.mark.parametrize(
    ("changes", "mode", "words"),
    [
        ({}, "leak", "jet T7: leaks 0.0500 N, 5 % of its thrust"),
        ({"magnitude": 0.004, "magnitude_std": 0.001}, "leak", "jet T7: leaks 0.0040 N, 0.4 % of its thrust"),
        ({"magnitude": 0.85, "magnitude_std": 0.04}, "leak", "jet T7: leaks 0.850 N, 85 % of its thrust"),
        ({"magnitude": 0.85, "magnitude_std": 0.06}, "stuck_on", "jet T7: stuck on"),  # within 3 sigma of all
        ({"magnitude": 0.91, "magnitude_std": 0.001}, "stuck_on", "jet T7: stuck on"),  # above 90 %
        ({"magnitude": 1.2, "magnitude_std": 0.01}, "stuck_on", "jet T7: stuck on"),
        ({"magnitude": -0.05}, "loss", "jet T7: loses 0.0500 N, 5 % of its thrust"),
        ({"magnitude": -0.5, "jet": None, "jets": ()}, "loss",
         "a jet of cluster 3: loses 0.5000 N, 50 % of its thrust"),
        ({"magnitude": -0.999}, "stuck_off", "jet T7: stuck off"),
        ({"pattern": "intermittent", "erratic_s": 12.0}, "intermittent", "jet T7: intermittent"),
        ({"pattern": "drifting", "erratic_s": 12.0}, "drift", "jet T7: drifts"),
        ({"isolated_to": "group", "jet": None, "jets": ("T7", "T8")}, "leak",
         "one of T7, T8: leaks 0.0500 N, 5 % of its thrust"),
        ({"thrust": 100.0, "magnitude": 25.0, "magnitude_std": 7.0}, "leak",
         "jet T7: leaks 25.0 N, 25 % of its thrust"),
        ({"thrust": None}, None, "jet T7: on"),
    ],
)  # fmt: skip
def test_a_jet_is_called_what_its_force_is(changes: dict[str, Any], mode: str | None, words: str) -> None:
    record = JET._replace(**changes)
    assert fault_mode(record) == mode
    assert in_words(record._replace(mode=mode), SI) == words


@pytest.mark.parametrize(
    ("changes", "mode", "words"),
    [
        ({}, None, "mass property jump"),
        ({"mass": -53.0, "mass_std": 2.0}, "release", "payload released"),
        ({"mass": 53.0, "mass_std": 2.0}, "docking", "payload docked"),
        ({"mass": 5.0, "mass_std": 2.0}, None, "mass property jump"),
        ({"mass": 0.0, "mass_std": 0.0}, None, "mass property jump"),
    ],
)  # fmt: skip
def test_a_payload_is_named_where_its_mass_is_known(changes: dict[str, Any], mode: str | None, words: str) -> None:
    record = PAYLOAD._replace(**changes)
    assert fault_mode(record) == mode
    assert in_words(record._replace(mode=mode), SI) == words
