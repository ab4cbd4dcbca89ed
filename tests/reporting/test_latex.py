"""LaTeX tables: what stands in them, and that no text from a file is a command."""

import re
import shutil
import subprocess
from dataclasses import replace

import pytest

from mfd_bayes.reporting import latex
from mfd_bayes.reporting.latex import escape, figure, laws_tex, parameters_tex, symbol

DOCUMENT = r"""\documentclass{article}
\usepackage{booktabs,array}
\begin{document}
\input{parameters.tex}
\input{laws.tex}
\end{document}
"""
SPECIAL = r"a_b%c&d#e$f\g{h}i~j^k"


def body(text):
    """Lines without the comments."""
    return [line for line in text.splitlines() if not line.startswith("%")]


def columns(line):
    return len(re.findall(r"(?<!\\)&", line)) + 1


@pytest.fixture
def hostile(campaign):
    """A campaign whose every text is full of what LaTeX takes for commands."""
    test, held = campaign.tests
    rows = tuple(replace(r, note=f"{SPECIAL} γ2 ≤ ½") for r in (*test.rows, test.rows[0]))
    rows = (*rows, replace(rows[0], name=f"[*{SPECIAL}", median=-1.5e-9, upper=float("inf")))
    tests = tuple(replace(test, id=f"{SPECIAL}{i}", actuation=SPECIAL, rows=rows) for i in range(4))
    law = replace(campaign.law_rows[0], name=f"exponent_{SPECIAL}", unit="kip*s/in**2", note="[x]")
    title = f"{SPECIAL}\n\\input{{secret}}\r日本"
    return replace(campaign, tests=(*tests, held), law_rows=(law,) * 30, title=title)


@pytest.mark.parametrize(
    ("text", "written"),
    [
        ("_%&#$", r"\_\%\&\#\$"),
        ("{}", r"\{\}"),
        ("\\", r"\textbackslash{}"),
        ("~^", r"\textasciitilde{}\textasciicircum{}"),
        ("a--b", "a-{}-{}b"),
        ("[1] *", "{[}1] {*}"),
        ("in²", "in$^2$"),
        ("ü 日 \x1b\n", "ü ?   "),
    ],
)
def test_text_is_printed_as_it_is(text, written):
    assert escape(text) == written


@pytest.mark.parametrize(
    ("value", "written"),
    [
        (24.5916, "24.6"),
        (-0.00091, "-0.000910"),
        (1.5e-9, r"1.50\times 10^{-9}"),
        (float("inf"), r"\infty"),
        (float("nan"), r"\mbox{--}"),
    ],
)
def test_numbers_are_maths(value, written):
    assert figure(value) == written


@pytest.mark.parametrize(
    ("name", "written"),
    [
        ("sigma0", r"$\sigma_0$"),
        ("K_c_fwd", r"$K_{c,\mathrm{fwd}}$"),
        ("Fc_bwd_0", r"$F_{c,\mathrm{bwd}}|_{p=0}$"),
        ("exponent_Fc_fwd", r"exponent of $F_{c,\mathrm{fwd}}$"),
        ("scatter_Fc_fwd", "scatter of slip force fwd"),
        ("my_own", "my own"),
    ],
)
def test_quantities_have_their_symbols(name, written):
    assert symbol(name) == written


def test_table_one_has_a_column_for_each_calibrated_test(campaign):
    text = parameters_tex(campaign)
    assert text.count(r"\begin{tabular}") == 1
    assert r"p800\_f0.25" in text
    assert "held" not in text  # it has no posterior of its own
    assert r"$k_3$ & kip/in & $1.00$" in text
    assert r"$[0.800,\,1.20]$" in text
    assert r"equal-tailed 95\,\% interval" in text


def test_a_figure_with_a_note_has_its_mark(campaign):
    test, held = campaign.tests
    rows = tuple(replace(r, note="not informed") if r.name == "k3" else r for r in test.rows)
    text = parameters_tex(replace(campaign, tests=(replace(test, rows=rows), held)))
    assert "$1.00{}^{a}$" in text
    assert "$^{a}$ not informed." in text
    assert "^{a}" not in parameters_tex(campaign)


@pytest.mark.parametrize(("count", "parts"), [(1, 1), (3, 1), (4, 2), (50, 17)])
def test_wide_campaigns_are_split_into_several_tabulars(campaign, count, parts):
    test = campaign.tests[0]
    tests = tuple(replace(test, id=f"p{i}") for i in range(count))
    text = parameters_tex(replace(campaign, tests=tests))
    assert text.count(r"\begin{tabular}") == text.count(r"\end{table}") == parts
    assert all(re.search(rf"\bp{i}\b", text) for i in range(count))
    assert (f"(1 of {parts})" in text) == (parts > 1)


def test_table_two_says_what_each_constant_is(campaign):
    (line,) = [line for line in body(laws_tex(campaign)) if "K_{c" in line]
    assert "kinetic friction per actuation" in line
    assert "in$^2$" in line
    assert r"$1.20$ $[1.00,\,1.40]$" in line


def test_every_row_has_as_many_cells_as_there_are_columns(hostile):
    for text, count in ((laws_tex(hostile), {4}), (parameters_tex(hostile), {5, 3})):
        rows = [line for line in body(text) if line.startswith("    ") and line.endswith(r" \\")]
        assert rows
        assert {columns(line) for line in rows} == count


def test_no_text_is_a_command(hostile):
    for text in (laws_tex(hostile), parameters_tex(hostile)):
        lines = body(text)
        assert not [line for line in lines if r"\input" in line or "secret" in line]
        plain = re.sub(r"\\[\\_%&#${}]", "", "\n".join(lines))
        assert not re.search(r"[%#~]", plain)
        assert plain.count("{") == plain.count("}")
        assert plain.count("$") % 2 == 0


def test_the_tables_without_a_test_or_a_law_are_empty(campaign):
    nothing = replace(campaign, tests=(), law_rows=())
    assert body(parameters_tex(nothing)) == body(laws_tex(nothing)) == []


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="no LaTeX here")
@pytest.mark.parametrize("broken", [False, True])
def test_latex_typesets_the_tables(hostile, tmp_path, broken, monkeypatch):
    if broken:  # the control: LaTeX does mind what is not escaped
        monkeypatch.setattr(latex, "_ESCAPED", {})
    (tmp_path / "parameters.tex").write_text(parameters_tex(hostile), encoding="utf-8")
    (tmp_path / "laws.tex").write_text(laws_tex(hostile), encoding="utf-8")
    (tmp_path / "main.tex").write_text(DOCUMENT)
    words = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "main.tex"]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, check=False, timeout=120)
    assert (done.returncode != 0) == broken, done.stdout.decode(errors="replace")[-2000:]
