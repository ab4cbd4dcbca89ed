import numpy as np
import pytest

from mfd_bayes.errors import RecordError
from mfd_bayes.records.columns import header_unit, roles_of, unit_of
from mfd_bayes.records.readers import Table


def table(tmp_path, *names, **units):
    return Table(tmp_path / "a.csv", {name: np.empty(0) for name in names}, units=units)


def test_header_units_may_be_quotients_and_stand_in_brackets():
    assert header_unit("velocity_in_per_s") == "in/s"
    assert header_unit("velocity_in/s") == "in/s"
    assert header_unit("actuator_1_lbf") == "lbf"
    assert header_unit("Force [kN]") == "kN"
    assert header_unit("Axial_Velocity (in/s)") == "in/s"
    assert header_unit("force") is None


def test_names_with_brackets_are_found(tmp_path):
    found = roles_of(table(tmp_path, "Time [s]", "Displacement(mm)", "Force"), {}, {})
    assert found == {"time": "Time [s]", "displacement": "Displacement(mm)", "force": "Force"}


@pytest.mark.parametrize(
    ("name", "row", "expected"),
    [
        ("force_kN", {}, "kN"),
        ("force", {"force": "Kips"}, "Kips"),
        ("axial_force", {"axial_force": "kN"}, "kN"),
        ("force_1", {"force_1": "kN"}, "kN"),
        ("force_kips", {"force_kips": "Kip"}, "kips"),
        ("force_kN", {"another": "mm"}, "kN"),
    ],
)
def test_the_names_unit_comes_before_the_files(tmp_path, name, row, expected):
    assert unit_of(table(tmp_path, name, **row), "force", name, {}) == expected
    assert unit_of(table(tmp_path, name, **row), "force", name, {"force": "lbf"}) == "lbf"


@pytest.mark.parametrize("theirs", ["lbf", "mm", "segments"])
def test_a_name_that_contradicts_the_file_is_refused(tmp_path, theirs):
    held = table(tmp_path, "force_kN", force_kN=theirs)
    with pytest.raises(RecordError) as caught:
        unit_of(held, "force", "force_kN", {})
    assert str(caught.value) == (
        f"column 'force_kN' of {held.path} is in 'kN' by its name and in {theirs!r} by the file's "
        "own units; give the unit of force"
    )


def test_a_column_without_a_unit_says_so(tmp_path):
    held = table(tmp_path, "force")
    with pytest.raises(RecordError) as caught:
        unit_of(held, "force", "force", {})
    assert str(caught.value) == (
        f"column 'force' of {held.path} has no unit in its name; give the unit of force"
    )


def test_of_time_and_displacement_one_may_be_named_and_the_other_found(tmp_path):
    held = table(tmp_path, "time_s", "displacement_in", "lvdt_in", "force_kip")
    expected = {"time": "time_s", "displacement": "lvdt_in"}
    assert roles_of(held, {"displacement": "lvdt_in"}, {}) == expected  # and no force
    assert roles_of(held, {}, {})["force"] == "force_kip"  # the control


def test_a_column_that_is_not_there_says_what_is(tmp_path):
    held = table(tmp_path, "time_s", "displacement_in")
    with pytest.raises(RecordError) as caught:
        unit_of(held, "force", "load", {})
    assert str(caught.value) == (
        f"missing column 'load' in {held.path}; it has time_s, displacement_in"
    )
