"""Layouts: named fields of packed vectors."""

from __future__ import annotations

import numpy as np
import pytest

from massprop_drake.maths.arrays import FLAG, NUMBER, Field, Layout

LAYOUT = Layout("sample", push=3, spread=(2, 2), gain=NUMBER, usable=FLAG)
VECTOR = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 1.0])
OF_JETS = Layout("of_jets", force="jets", effects=(3, "jets"), told=Field("told", "{force}", shape="jets"), last=NUMBER)


def test_a_vector_is_read_by_names_in_their_order() -> None:
    assert LAYOUT.size == 9
    assert [LAYOUT.slice(name) for name in LAYOUT] == [slice(0, 3), slice(3, 7), slice(7, 8), slice(8, 9)]
    read = LAYOUT.read(VECTOR)
    assert (type(read).__name__, type(read)._fields) == ("sample", ("push", "spread", "gain", "usable"))
    np.testing.assert_array_equal(read.push, [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(read.spread, [[4.0, 5.0], [6.0, 7.0]])  # row by row
    assert (type(read.gain), read.gain, type(read.usable), read.usable) == (float, 8.0, bool, True)
    assert np.shares_memory(read.push, VECTOR)
    assert np.shares_memory(read.spread, VECTOR)
    assert not np.shares_memory(LAYOUT.pack(read), VECTOR)


def test_packed_values_are_read_again_and_the_other_way_round() -> None:
    np.testing.assert_array_equal(LAYOUT.pack(LAYOUT.read(VECTOR)), VECTOR)
    values = (np.array([np.nan, -0.0, np.inf]), np.arange(4.0).reshape(2, 2).T, -2.5, False)
    read = LAYOUT.read(LAYOUT.pack(values))
    for found, value in zip(read, values, strict=True):
        np.testing.assert_array_equal(found, value)
    assert np.signbit(read.push[1])


@pytest.mark.parametrize(("element", "flag"), [(0.0, False), (-0.0, False), (0.5, True), (np.nan, True)])
def test_a_flag_is_whether_its_element_is_not_zero(element: float, flag: bool) -> None:
    assert Layout("one", flag=FLAG).read(np.array([element])).flag is flag


@pytest.mark.parametrize("values", [(np.zeros(3),), (np.zeros(2), np.zeros((2, 2)), 0.0, False)])
def test_values_that_do_not_fit_are_refused(values: tuple[object, ...]) -> None:
    with pytest.raises(ValueError, match=r"argument 2 is shorter|could not broadcast"):
        LAYOUT.pack(values)


def test_words_for_sizes_are_replaced() -> None:
    layout = OF_JETS.sized(jets=4)
    read = layout.read(np.arange(21.0))
    assert (layout.size, read.force.shape, read.effects.shape, read.told.shape) == (21, (4,), (3, 4), (4,))
    np.testing.assert_array_equal(read.effects[1], [8.0, 9.0, 10.0, 11.0])
    assert read.last == 20.0
    assert OF_JETS.sized(jets=0).read(np.array([5.0])).effects.shape == (3, 0)
    partly = Layout("two", rates=("gyros", 3), force="jets").sized(jets=4)
    assert not hasattr(OF_JETS, "size")
    assert not hasattr(partly, "size")
    assert partly.sized(gyros=2).size == 10
    assert LAYOUT.sized(jets=4).read(VECTOR).usable is True  # number and flag are no words


def test_logs_signals_and_descriptions() -> None:
    columns = LAYOUT.columns(np.vstack([VECTOR, 10.0 * VECTOR]))
    assert list(columns) == list(LAYOUT)
    np.testing.assert_array_equal(columns["push"], [[1.0, 2.0, 3.0], [10.0, 20.0, 30.0]])
    np.testing.assert_array_equal(columns["spread"][1], [40.0, 50.0, 60.0, 70.0])
    assert columns["gain"].shape == columns["usable"].shape == (2, 1)
    made = LAYOUT.make(gain=2.0, push=np.zeros(3))
    assert (type(made), made.gain) == (type(LAYOUT.read(VECTOR)), 2.0)
    assert np.isnan([made.usable, made.spread]).all()  # not given
    assert OF_JETS.logged == {"told": Field("told", "{force}", shape="jets")}
    assert OF_JETS.sized(jets=4).logged["told"].unit == "{force}"
    assert LAYOUT.logged == {}
    assert OF_JETS.describe() == "force (jets), effects (3 x jets), told (jets), last (1)"
    assert repr(LAYOUT) == "<Layout sample: push (3), spread (2 x 2), gain (1), usable (1)>"
