import subprocess
import sys

import pytest

from mfd_bayes.errors import UnitError
from mfd_bayes.records.record import parse_window
from mfd_bayes.units import (
    DIMENSIONS,
    convert,
    factor,
    force_and_length,
    measure,
    parse_actuation,
    parse_quantity,
    same_unit,
)


def test_factors_match_the_definitions():
    for kind, dimension in DIMENSIONS.items():
        assert factor(dimension.unit, kind) == 1, kind
    for unit, kind, expected in (
        ("mm", "displacement", 1 / 25.4),
        ("ms", "time", 1e-3),
        ("N", "force", 1 / 4448.2216152605),
        ("psi", "pressure", 1e-3),
        ("MPa", "pressure", 1 / 6.894757293168361),
        ("bar", "pressure", 0.1 / 6.894757293168361),
        ("kN/mm", "stiffness", 25.4 / 4.4482216152605),
        ("mm^2", "area", 1 / 25.4**2),
        ("%", "dimensionless", 0.01),
        ("pounds/in^2", "pressure", 1e-3),
        ("kgf", "force", 9.80665e-3 / 4.4482216152605),
        ("mils", "displacement", 1e-3),
        ("µm", "displacement", 1e-3 / 25.4),
        ('"', "displacement", 1.0),
    ):
        assert factor(unit, kind) == pytest.approx(expected, rel=1e-12), unit


def test_the_usual_spellings_of_laboratories_are_understood():
    for kind, unit, spellings in (
        ("time", "s", "S sec Sec SEC secs Secs sec. second Seconds SECONDS"),
        ("displacement", "in", "In IN in. inch Inch inches Inches"),
        ("displacement", "mm", "MM millimeter Millimetres"),
        ("force", "lbf", "lb Lb LB lbs Lbs lbs. LBF Lbf pounds Pounds"),
        ("force", "kip", "Kip KIP kips Kips KIPS klbf Klbf"),
        ("force", "kN", "KN Kn kn kilonewtons"),
        ("force", "N", "newton Newtons"),
        ("pressure", "psi", "Psi PSI psig PSIG"),
        ("stiffness", "kip/in", "Kips/In kips/inch"),
    ):
        for spelling in spellings.split():
            assert factor(spelling, kind) == pytest.approx(factor(unit, kind), rel=1e-12), spelling
            assert same_unit(spelling, unit)


def test_a_prefix_is_not_taken_for_another():
    assert factor("MN", "force") == pytest.approx(1e3 * factor("kN", "force"))
    assert factor("mN", "force") == pytest.approx(1e-6 * factor("kN", "force"))
    assert factor("Mm", "displacement") == pytest.approx(1e9 * factor("mm", "displacement"))


def test_what_a_unit_measures_is_named_and_none_where_it_is_unknown():
    assert (measure("Kips"), measure("in/s")) == ("force", "velocity")
    for unknown in ("segments", "", "delta_decibel"):  # pint knows the last by half
        assert measure(unknown) is None
        assert not same_unit("kN", unknown)
    assert same_unit("kN/mm", "MN/m")
    assert not same_unit("kN", "lbf")


def test_powers_of_force_and_length_are_those_of_a_units_dimension():
    units = {"kip": (1, 0), "kip/in": (1, -1), "kip*in": (1, 1), "in": (0, 1), "1": (0, 0)}
    units |= {"kip*s/in": (1, -1), "kN*s/mm": (1, -1), "ksi": (1, -2), "in/s": (0, 1), "s": (0, 0)}
    assert {unit: force_and_length(unit) for unit in units} == units


def test_a_swapped_unit_says_what_it_measures_and_what_is_needed():
    with pytest.raises(UnitError, match=r"'displacement_in' measures force.* such as 'in' or 'mm'"):
        factor("kip", "displacement", of="column 'displacement_in'")


def test_malformed_offset_and_logarithmic_units_are_unit_errors():
    words = "furlongz ( ) # s** in**s 1/0 9**9**9 degC degF mol __import__ dB"
    for unit in ("", " ", "2 psi", "m" * 99, *words.split(" ")):
        for kind in DIMENSIONS:
            with pytest.raises(UnitError):
                factor(unit, kind)
    for unit, target in (("degC", "K"), ("dB", "1")):
        with pytest.raises(UnitError, match="plain multiple"):
            convert(unit, target)


def test_quantities_come_out_in_internal_units():
    assert parse_quantity("500 psi", "pressure") == pytest.approx(0.5)
    assert parse_quantity("-25.4mm", "displacement") == pytest.approx(-1)
    assert parse_quantity("64 Hz", "rate") == 64
    for text, expected in (("500 psi", (0.5, "ksi")), ("30 lbf", (0.03, "kip")), ("2 A", (2, "A"))):
        assert parse_actuation(text) == (pytest.approx(expected[0]), expected[1])


def test_windows_are_two_increasing_times():
    assert parse_window("0 s to 1500 ms") == (0, 1.5)
    for text in ("0 to 60 s", "60 s to 0 s", "1 s", "1 s to 2 kip"):
        with pytest.raises(UnitError):
            parse_window(text)


def test_importing_the_package_and_its_units_does_not_import_pint():
    code = "import sys, mfd_bayes, mfd_bayes.units; sys.exit('pint' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_what_is_no_quantity_is_refused_at_once():
    for text in ("500", "psi", "", "five psi", "1e999 psi", "nan psi", "-5 psi", "5 5 psi"):
        with pytest.raises(UnitError):
            parse_actuation(text)
    for text in ("1" + " " * 10**6 + "\n x\ny", "9" * 10**6, " " * 10**6):
        with pytest.raises(UnitError, match="expected a number and a unit") as caught:
            parse_quantity(text, "force")
        assert len(str(caught.value)) < 300
