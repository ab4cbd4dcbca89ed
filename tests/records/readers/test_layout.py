from functools import partial

import pytest

from mfd_bayes.records.readers.cells import is_number
from mfd_bayes.records.readers.layout import SEARCHED, find_layout, units_of

found = partial(find_layout, is_number=is_number)


def test_the_row_of_names_stands_above_the_largest_share_of_numbers():
    rows = [["Rate", "1024"], ["Station", "A"], ["a", "x"], ["t", "f"], ["1", "2"], ["3", "4"]]
    layout = found(rows)
    assert (layout.names, layout.units, layout.data) == (3, None, 4)
    assert (layout.share, layout.count) == (1.0, 4)


@pytest.mark.parametrize(
    ("units", "is_row_of_units"),
    [
        (["s", "mm", "kN"], True),
        (["SEC", "Inches", "kips"], True),
        (["[s]", "(in)", "{lbf}"], True),
        (["s", "mm", ""], True),
        (["s", "mm", "segments"], True),
        (["s", "volts", "kN"], True),
        (["first", "second trial", "kN"], False),
        (["s", "count", "%"], False),
        (["t", "F", "V"], False),
    ],
)
def test_a_row_of_units_measures_what_records_hold(units, is_row_of_units):
    layout = found([["a", "b", "c"], units, ["1", "2", "3"]])
    assert layout.data == 2
    assert (layout.names, layout.units) == ((0, 1) if is_row_of_units else (1, None))


def test_units_need_names_above_them():
    layout = found([["Brake", "7"], ["Lab", "B"], ["s", "in", "kip"], ["1", "2", "3"]])
    assert (layout.names, layout.units) == (2, None)


@pytest.mark.parametrize(
    "rows", [[], [["a", "b"]], [["a"], ["1"]], [["1", "2"], ["3", "4"]], [["a", "1"], ["2", "3"]]]
)
def test_without_two_names_above_numbers_there_is_no_table(rows):
    assert found(rows) is None


def test_units_are_bare_and_dashes_are_none():
    assert units_of(["a", "b", "c", "d"], ["[kN]", " mm ", "-", None]) == {"a": "kN", "b": "mm"}


def test_names_are_looked_for_far_enough():
    assert SEARCHED >= 100


def test_a_few_settings_are_not_the_table():
    data = [[str(i / 50), str(i), "held"] for i in range(60)]
    rows = [["Rate", "Channels"], ["1024", "4"], ["time_s", "disp_mm", "mode"], *data]
    assert found(rows).names == 2
    assert found(rows[:2]).names == 0  # the control: where there is nothing else
