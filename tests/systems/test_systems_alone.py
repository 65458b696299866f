"""A system by itself: few lines, and a message where a shape is not meant."""

from __future__ import annotations

import ast
import importlib
import inspect
import re
from typing import Any

import numpy as np
import pytest
from pydrake.systems.framework import Diagram, LeafSystem, System

from massprop_drake import InputError, load_scenario, load_vehicle, systems
from massprop_drake.diagrams import closed_loop, open_loop, replay
from massprop_drake.maths.vehicle.rigid_body import N_STATE, RATE
from massprop_drake.systems import ImpulseModel, IntegratingAccelerometer, RateGyro

ORBITER = load_vehicle("orbiter")


def test_a_package_of_a_vehicle_in_three_lines() -> None:
    gyro = RateGyro(ORBITER.gyro("gyro"))
    context = gyro.CreateDefaultContext()
    state, quantum = np.zeros(N_STATE), ORBITER.gyro("gyro").quantum
    state[RATE] = [2.2 * quantum, 0.0, -0.7 * quantum]
    gyro.GetInputPort("body_state").FixValue(context, state)
    reading = gyro.GetOutputPort("reading").Eval(context)
    np.testing.assert_allclose(reading, [2.0 * quantum, 0.0, -quantum], atol=1e-9 * quantum)
    assert gyro.get_name() == "gyro"
    assert IntegratingAccelerometer(ORBITER.accelerometer("acc2")).get_name() == "acc2"


JETS = {"time_constants_s": np.zeros(2), "period_s": 0.1}


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: IntegratingAccelerometer(ORBITER.accelerometer("acc2"), position=4.0), "'acc2': position: must be a"),
        (lambda: IntegratingAccelerometer(ORBITER.gyro("gyro")), "where does it stand"),
        (lambda: ORBITER.gyro("gyro_1"), "'gyro_1' is no gyro package"),
        (lambda: ORBITER.gyro("acc1"), "'acc1' is no gyro package"),
        (lambda: RateGyro("gyro"), "a name alone has no errors"),
        (lambda: ImpulseModel(wrenches=np.zeros(6), **JETS), r"must be rows of 6 numbers, one for each jet, got shape"),
        (lambda: ImpulseModel(wrenches=np.zeros((1, 6)), **JETS), r"must be a vector of 1 numbers, got shape \(2,\)"),
        (
            lambda: ImpulseModel(wrenches=np.zeros((2, 6)), **(JETS | {"time_constants_s": np.array(0.0)})),
            "time_constants_s: must be a vector of 2 numbers, got the number 0",
        ),
    ],
)
def test_what_is_not_meant_is_told(make: Any, message: str) -> None:
    with pytest.raises((ValueError, InputError), match=message):
        make()


def made(name: str) -> type:
    """The class of a public name; of a template that for float."""
    found: Any = getattr(systems, name)
    kind: type = found[float] if name.endswith("_") else found
    return kind


def own_parts(diagrams: list[Diagram]) -> list[System]:
    """Every system of ours in some diagrams."""
    waiting, found = list[System](diagrams), list[System]()
    while waiting:
        system = waiting.pop()
        if isinstance(system, Diagram):
            waiting += [] if system.get_name() == "noise_seed" else system.GetSystems()  # whose parts serve it alone
        elif type(system).__module__.startswith("massprop_drake"):
            found.append(system)
    return found


def test_every_system_has_a_public_name() -> None:
    public = {made(name) for name in systems.__all__}
    assert all(issubclass(kind, LeafSystem | Diagram) for kind in public)
    floats, thesis = load_scenario("air_bearing_pulses"), load_scenario("stuck_on_29", ["estimation.filter=thesis"])
    loops = [closed_loop.build(load_scenario("leak_named")), closed_loop.build(thesis)]
    assert {type(part) for part in own_parts([*loops, open_loop.build(floats), replay.build(floats)])} <= public
    with pytest.raises(AttributeError, match="has no attribute 'Nothing'"):
        systems.Nothing  # noqa: B018


KINDS = [kind for name in systems.__all__ for kind in made(name).__mro__]
MODULES = sorted({kind.__module__ for kind in KINDS if kind.__module__.startswith("massprop_drake")})


@pytest.mark.parametrize("module", MODULES)
def test_a_system_changes_no_attribute_of_its_own(module: str) -> None:
    """What changes is in the context: attributes are set when the system is made and its parts are declared."""
    kinds = list(ast.walk(ast.parse(inspect.getsource(importlib.import_module(module)))))
    methods = [each for kind in kinds if isinstance(kind, ast.ClassDef) for each in kind.body]
    for method in methods:
        if isinstance(method, ast.FunctionDef) and not re.match("__init__$|_declare|_construct", method.name):
            stored = [node for node in ast.walk(method) if isinstance(node, ast.Attribute | ast.Subscript)]
            changed = [ast.unparse(node) for node in stored if isinstance(node.ctx, ast.Store | ast.Del)]
            assert [one for one in changed if one.startswith("self.")] == [], f"{module}: {method.name}"
