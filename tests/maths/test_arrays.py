"""Layouts: named fields of packed vectors."""

from __future__ import annotations

import numpy as np
import pytest

from massprop_drake.maths.arrays import FLAG, NUMBER, Field, Layout

LAYOUT = Layout("sample", push=3, spread=(2, 2), gain=NUMBER, usable=FLAG)
VECTOR = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 1.0])


def test_fields_lie_in_their_order() -> None:
    assert LAYOUT.size == 9
    assert list(LAYOUT) == ["push", "spread", "gain", "usable"]
    assert [LAYOUT.slice(name) for name in LAYOUT] == [slice(0, 3), slice(3, 7), slice(7, 8), slice(8, 9)]


def test_a_vector_is_read_by_names() -> None:
    read = LAYOUT.read(VECTOR)
    np.testing.assert_array_equal(read.push, [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(read.spread, [[4.0, 5.0], [6.0, 7.0]])  # row by row
    assert (type(read.gain), read.gain) == (float, 8.0)
    assert (type(read.usable), read.usable) == (bool, True)
    assert type(read).__name__ == "sample"


def test_arrays_that_are_read_are_views() -> None:
    vector = VECTOR.copy()
    read = LAYOUT.read(vector)
    assert np.shares_memory(read.push, vector)
    assert np.shares_memory(read.spread, vector)


def test_what_is_packed_is_read_again_and_the_other_way_round() -> None:
    np.testing.assert_array_equal(LAYOUT.pack(LAYOUT.read(VECTOR)), VECTOR)
    values = (np.array([np.nan, -0.0, np.inf]), np.arange(4.0).reshape(2, 2).T, -2.5, False)
    read = LAYOUT.read(LAYOUT.pack(values))
    for found, value in zip(read, values, strict=True):
        np.testing.assert_array_equal(found, value)
    assert np.signbit(read.push[1])


def test_packing_makes_a_new_vector() -> None:
    read = LAYOUT.read(VECTOR)
    assert not np.shares_memory(LAYOUT.pack(read), VECTOR)


@pytest.mark.parametrize(("element", "flag"), [(0.0, False), (-0.0, False), (1.0, True), (0.5, True), (np.nan, True)])
def test_a_flag_is_whether_its_element_is_not_zero(element: float, flag: bool) -> None:
    read = Layout("one", flag=FLAG).read(np.array([element]))
    assert read.flag is flag


def test_one_number_is_an_array_when_its_size_is_given_and_a_float_otherwise() -> None:
    read = Layout("two", array=1, number=NUMBER).read(np.array([3.0, 4.0]))
    np.testing.assert_array_equal(read.array, [3.0])
    assert read.number == 4.0


@pytest.mark.parametrize("values", [(np.zeros(3),), (np.zeros(2), np.zeros((2, 2)), 0.0, False)])
def test_values_that_do_not_fit_are_refused(values: tuple[object, ...]) -> None:
    with pytest.raises(ValueError, match=r"argument 2 is shorter|could not broadcast"):
        LAYOUT.pack(values)


# ------------------------------------------------------------------------------------------- words

OF_JETS = Layout("of_jets", force="jets", effects=(3, "jets"), told=Field("told", "{force}", shape="jets"), last=NUMBER)


def test_words_for_sizes_are_replaced() -> None:
    layout = OF_JETS.sized(jets=4)
    assert layout.size == 4 + 12 + 4 + 1
    read = layout.read(np.arange(21.0))
    assert (read.force.shape, read.effects.shape, read.told.shape) == ((4,), (3, 4), (4,))
    np.testing.assert_array_equal(read.effects[1], [8.0, 9.0, 10.0, 11.0])
    assert read.last == 20.0


def test_a_size_may_be_zero() -> None:
    layout = OF_JETS.sized(jets=0)
    assert layout.size == 1
    assert layout.read(np.array([5.0])).effects.shape == (3, 0)


def test_a_layout_has_no_size_before_its_words_are_replaced() -> None:
    assert not hasattr(OF_JETS, "size")
    assert not hasattr(Layout("two", rates=("gyros", 3), force="jets").sized(jets=4), "size")  # but for all of them
    assert Layout("two", rates=("gyros", 3), force="jets").sized(jets=4).sized(gyros=2).size == 10


def test_number_and_flag_are_no_words_for_sizes() -> None:
    assert LAYOUT.sized(jets=4).read(VECTOR).usable is True


# ------------------------------------------------------------------------------------ logs and words


def test_columns_of_a_log_keep_their_rows() -> None:
    log = np.vstack([VECTOR, 10.0 * VECTOR])
    columns = LAYOUT.columns(log)
    assert list(columns) == list(LAYOUT)
    np.testing.assert_array_equal(columns["push"], [[1.0, 2.0, 3.0], [10.0, 20.0, 30.0]])
    np.testing.assert_array_equal(columns["spread"][1], [40.0, 50.0, 60.0, 70.0])
    assert columns["gain"].shape == columns["usable"].shape == (2, 1)


def test_what_is_not_given_is_not_a_number() -> None:
    made = LAYOUT.make(gain=2.0, push=np.zeros(3))
    assert made.gain == 2.0
    assert np.isnan(made.usable)
    assert np.isnan(made.spread)
    assert type(made) is type(LAYOUT.read(VECTOR))


def test_fields_that_are_signals_are_known_before_and_after_sizing() -> None:
    logged = {"told": Field("told", "{force}", shape="jets")}
    assert OF_JETS.logged == logged
    assert list(OF_JETS.sized(jets=4).logged) == ["told"]
    assert OF_JETS.sized(jets=4).logged["told"].unit == "{force}"
    assert LAYOUT.logged == {}


def test_a_layout_describes_itself() -> None:
    assert LAYOUT.describe() == "push (3), spread (2 x 2), gain (1), usable (1)"
    assert OF_JETS.describe() == "force (jets), effects (3 x jets), told (jets), last (1)"
    assert repr(LAYOUT) == f"<Layout sample: {LAYOUT.describe()}>"
