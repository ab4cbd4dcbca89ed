"""Symbols, numbers and units as engineers write them, in figures and on pages."""

import math

from mfd_bayes.calibration.priors import known_quantities
from mfd_bayes.reporting import symbols

NAMES = symbols.Symbols()


def test_every_quantity_has_a_symbol_and_unknown_names_are_escaped():
    for name in known_quantities():
        assert NAMES.in_figure(name).startswith("$"), name
        assert NAMES.in_html(name), name
        assert NAMES.meaning(name), name
    assert NAMES.parts("Fc_fwd") == [("F", False), ("c,fwd", True)]
    assert NAMES.label("sigma0", "kip/in") == r"$\sigma_0$, kip/in"
    assert NAMES.label("gamma1", "1") == r"$\gamma_1$"
    assert NAMES.in_html("<b>_x") == "&lt;b&gt; x"
    assert NAMES.in_figure("a$b$") == r"a\$b\$"
    assert symbols.plain("a\nb" + "x" * 80) == "a b" + "x" * 56 + "…"


def test_numbers_and_units_are_written_as_engineers_do():
    values = (1.3, 1234.4, 0.00012345, 1.25e-7, -2.5, 123456.0, 1.5e7, 0.0, math.nan, -math.inf)
    texts = ["1.300", "1234", "0.0001234", "1.250e−7", "−2.500", "123500", "1.500e7", "0.000"]
    assert [symbols.number(value) for value in values] == [*texts, "–", "−∞"]
    units = [symbols.unit_text(unit) for unit in ("kip*s/in", "1", "in**2", "")]
    assert units == ["kip·s/in", "", "in²", ""]
    assert symbols.percent(0.95, 0) == "95\u00a0%"
    assert symbols.count(1234.4) == "1\u202f234"


def test_quantities_of_the_population_are_written_in_words():
    for name, text, meaning in (
        ("scatter_Fc_fwd", "scatter of slip force fwd", "slip force at a common speed"),
        ("scatter_d3", "scatter of d3/d2", "ratio d3/d2"),
        ("deviation_level_friction", "deviation by level, friction", "deviation from the law"),
        ("share_sigma0", "share of σ<sub>0</sub>", "share of the value"),
        ("dependence_d2_velocity", "dependence of d<sub>2</sub> on velocity", "on velocity"),
    ):
        assert NAMES.in_html(name) == text
        assert meaning in NAMES.meaning(name), name
    for text, html in (
        ("not determined: sigma1 (7), k3", "not determined: σ<sub>1</sub> (7), k<sub>3</sub>"),
        ("the gap of a<b is Fc_fwd.", "the gap of a&lt;b is F<sub>c,fwd</sub>."),
    ):
        assert NAMES.sentence(text) == html
