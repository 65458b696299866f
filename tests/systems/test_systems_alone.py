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
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.maths.vehicle.rigid_body import N_STATE, RATE
from massprop_drake.systems import ImpulseModel, IntegratingAccelerometer, RateGyro


def test_a_gyro_in_three_lines() -> None:
    orbiter = load_vehicle("orbiter")
    gyro = RateGyro(orbiter.gyro("gyro"))
    context = gyro.CreateDefaultContext()
    state, quantum = np.zeros(N_STATE), orbiter.gyro("gyro").quantum
    state[RATE] = [2.2 * quantum, 0.0, -0.7 * quantum]
    gyro.GetInputPort("body_state").FixValue(context, state)
    reading = gyro.GetOutputPort("reading").Eval(context)
    np.testing.assert_allclose(reading, [2.0 * quantum, 0.0, -quantum], atol=1e-9 * quantum)
    assert gyro.get_name() == "gyro"


def test_an_accelerometer_stands_where_its_package_does(orbiter: Vehicle) -> None:
    assert IntegratingAccelerometer(orbiter.accelerometer("acc2")).get_name() == "acc2"
    with pytest.raises(ValueError, match="'acc2': position: must be a vector of 3 numbers, got the number 4"):
        IntegratingAccelerometer(orbiter.accelerometer("acc2"), position=4.0)
    with pytest.raises(ValueError, match="where does it stand"):
        IntegratingAccelerometer(orbiter.gyro("gyro"))


@pytest.mark.parametrize("name", ["gyro_1", "acc1"])
def test_a_package_that_is_not_there_is_named(orbiter: Vehicle, name: str) -> None:
    with pytest.raises(InputError, match=f"'{name}' is no gyro package"):
        orbiter.gyro(name)


def test_a_name_alone_has_no_errors() -> None:
    with pytest.raises(ValueError, match="a name alone has no errors"):
        RateGyro("gyro")


def test_wrenches_are_rows() -> None:
    with pytest.raises(ValueError, match=r"wrenches: must be rows of 6 numbers, one for each jet, got shape \(6,\)"):
        ImpulseModel(wrenches=np.zeros(6), time_constants_s=np.zeros(1), period_s=0.1)
    with pytest.raises(ValueError, match="time_constants_s: must be a vector of 2 numbers, got the number 0"):
        ImpulseModel(wrenches=np.zeros((2, 6)), time_constants_s=np.array(0.0), period_s=0.1)


def _made(name: str) -> type:
    """The class of a public name; of a template that for float."""
    found: Any = getattr(systems, name)
    made: type = found[float] if name.endswith("_") else found
    return made


def _is_own(kind: type) -> bool:
    return kind.__module__.startswith("massprop_drake")


def test_every_system_has_a_public_name() -> None:
    public = {_made(name) for name in systems.__all__}
    assert all(issubclass(kind, (LeafSystem, Diagram)) for kind in public)
    assert {type(system) for system in _parts_of_diagrams()} <= public
    with pytest.raises(AttributeError, match="has no attribute 'Nothing'"):
        systems.Nothing  # noqa: B018


def _parts_of_diagrams() -> list[System]:
    """Every system of ours in the diagrams with each filter."""
    waiting: list[System] = [
        closed_loop.build(load_scenario("leak_named")),
        closed_loop.build(load_scenario("stuck_on_29", ["estimation.filter=thesis"])),
        *(open_loop.build(load_scenario("air_bearing_pulses")), replay.build(load_scenario("air_bearing_pulses"))),
    ]
    found: list[System] = []
    while waiting:
        system = waiting.pop()
        if isinstance(system, Diagram):
            waiting += [] if system.get_name() == "noise_seed" else system.GetSystems()  # whose parts serve it alone
        elif type(system).__module__.startswith("massprop_drake"):
            found.append(system)
    return found


MODULES = sorted({kind.__module__ for name in systems.__all__ for kind in (_made(name)).__mro__ if _is_own(kind)})


@pytest.mark.parametrize("module", MODULES)
def test_a_system_changes_no_attribute_of_its_own(module: str) -> None:
    """What changes is in the context: attributes are set when the system is made and its parts are declared."""
    tree = ast.parse(inspect.getsource(importlib.import_module(module)))
    methods = [
        method
        for kind in ast.walk(tree)
        if isinstance(kind, ast.ClassDef)
        for method in kind.body
        if isinstance(method, ast.FunctionDef) and not re.match("__init__$|_declare|_construct", method.name)
    ]
    for method in methods:
        stored = [node for node in ast.walk(method) if isinstance(node, ast.Attribute | ast.Subscript)]
        changed = [ast.unparse(node) for node in stored if isinstance(node.ctx, ast.Store | ast.Del)]
        assert [one for one in changed if one.startswith("self.")] == [], f"{module}: {method.name}"
