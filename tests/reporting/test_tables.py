"""Tables for other programs and for papers, opened by the readers that others use."""

import csv
import io
import json
import math
import re
import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from mfd_bayes.evaluation.views import Check
from mfd_bayes.reporting import tables
from mfd_bayes.reporting.symbols import Symbols
from mfd_bayes.reporting.tables import (
    datasheet_frame,
    datasheet_sheet,
    escape_tex,
    number_tex,
    paper_sheets,
    predicted_csv,
    record_table,
    report_tables,
    shared_tables,
    symbol_tex,
    to_csv,
    to_excel,
    to_latex,
    to_word,
)
from mfd_bayes.runs.folder import discard
from mfd_bayes.runs.unit_system import SI
from mfd_bayes.runs.verdict import Verdict

STIFFNESS = 4.4482216 / 25.4  # kN/mm of a kip/in
SPECIAL = r"a_b%c&d#e$f\g{h}i~j^k"
DOCUMENT = r"""\documentclass{article}
\usepackage{booktabs,array}
\begin{document}
\input{parameters.tex}
\input{laws.tex}
\end{document}
"""


NAMES = Symbols()
ESTIMATE = {"name": "k3", "unit": "kip/in", "value": 14.25, "lower": 0.8, "median": 1.0}
ESTIMATE |= {"upper": 1.2, "tolerance": 0.3, "missed": True}
NOISE = {"name": "k3", "unit": "kip/in", "noise": "ou", "lower": 0.8, "median": 1.0, "upper": 1.2}
NOISE |= {"other": "staged", "other_lower": 39.0, "other_median": 42.2, "other_upper": 45.6}
NOISE |= {"decides": True}


def tex(view):
    """Tables I and II in LaTeX, in the units of a report."""
    one, two = (sheet.to_units(view.system) for sheet in paper_sheets(view, NAMES))
    return {
        "parameters.tex": to_latex("parameters", one, NAMES),
        "laws.tex": to_latex("laws", two, NAMES),
    }


def read(text):
    return list(csv.DictReader(io.StringIO(text)))


def of_two(view, **changes):
    """The view with its first test changed, and the second as it is."""
    return replace(view, tests=(replace(view.tests[0], **changes), *view.tests[1:]))


COLUMNS = {
    "parameters": "test parameter unit mean sd q2.5 q50 q97.5 ess_bulk ess_tail r_hat contraction",
    "checks": "test check feature observed expected unit difference tolerance p_value status",
    "laws": "group constant unit mean sd q2.5 q50 q97.5 ess_bulk ess_tail r_hat",
    "law_scores": "quantity law chosen elpd elpd_se elpd_difference",
    "scores": "test role coverage_50 coverage_90 coverage_95 width_95_kip",
    "tested_range": "condition unit smallest largest",
    "loop_estimates": "test quantity unit loop_estimate q2.5 q50 q97.5 tolerance missed",
    "noises": "test quantity unit noise q2.5 q50 q97.5 other_noise other_q2.5 other_q50",
    "derived": "test role quantity unit mean sd q2.5 q50 q97.5 measured note",
    "crossvalidation": "part test coverage_50 coverage_90 coverage_95 width_95_kip",
}


def test_other_programs_find_the_columns(campaign):
    texts = report_tables(campaign)
    for name, columns in COLUMNS.items():
        first = texts[f"{name}.csv"].splitlines()[0].split(",")
        assert first[: len(columns.split())] == columns.split()


def test_values_are_those_of_the_report(campaign):
    texts = report_tables(campaign)
    assert float(read(texts["parameters.csv"])[1]["q97.5"]) == 1.2
    assert [line["role"] for line in read(texts["scores.csv"])] == ["calibrate", "validate"]
    derived = read(texts["derived.csv"])
    assert [line["measured"] for line in derived][:3] == ["3.3", "1.4", ""]
    assert derived[3]["q50"] == ""  # no full cycle
    left_out = read(texts["crossvalidation.csv"])
    assert [(line["part"], line["test"]) for line in left_out] == [
        ("800 psi", "p800_f0.25"),
        ("", "mean"),
    ]
    laws = read(texts["law_scores.csv"])
    assert [(line["law"], line["chosen"]) for line in laws] == [
        ("power", "no"),
        ("proportional", "yes"),
    ]
    assert "crossvalidation.csv" not in report_tables(replace(campaign, left_out=None))


def test_a_prediction_says_what_it_is(campaign):
    about, other, *table = predicted_csv(campaign.tests[0].derived, "800 psi", 0.9).splitlines()
    assert "90 % intervals" in about
    assert other.startswith("# actuation 800 psi")
    assert read("\n".join(table))[0]["quantity"] == "energy_per_cycle"


def test_a_new_run_in_a_folder_removes_every_table_of_the_old_one(campaign, tmp_path):
    (tmp_path / "manifest.json").write_text("{}")
    sheets = (f"datasheet.{end}" for end in ("csv", "tex", "html", "pdf"))
    for name in (*report_tables(campaign), *sheets):
        (tmp_path / name).write_text("")
    discard(tmp_path)
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize("text", ["=1+1", "-1", "\t@SUM(A1)"])
def test_no_text_is_a_formula(text, campaign):
    row = {"test": text, "note": text, "mean": -1.25e-7, "r_hat": math.nan}
    rows = (campaign.law_rows[0] | row,)
    check = Check(text, "a, b", 'say "x"', -1.0, 1.0, Verdict.PASS)
    texts = report_tables(replace(campaign, law_rows=rows, checks=(check,)))
    line = read(texts["laws.csv"])[0]
    assert line["group"] == line["note"] == f"'{text}".replace("\r", " ").replace("\t", " ")
    assert (line["mean"], line["r_hat"]) == ("-1.25e-07", "")
    found = read(texts["checks.csv"])[0]
    assert (found["check"], found["feature"], found["observed"]) == ("a, b", 'say "x"', "-1")


def test_every_table_of_a_metric_report_is_in_kn_and_mm(campaign):
    name = campaign.tests[0].id
    estimate = ESTIMATE | {"test": name}
    view = replace(of_two(campaign, loop_estimates=(estimate,)), metric=True)
    texts = report_tables(view) | tex(view)
    row = next(r for r in read(texts["parameters.csv"]) if r["parameter"] == "k3")
    assert row["unit"] == "kN/mm"
    assert float(row["q50"]) == pytest.approx(STIFFNESS, rel=1e-5)
    assert float(read(texts["loop_estimates.csv"])[0]["loop_estimate"]) == pytest.approx(
        14.25 * STIFFNESS, rel=1e-5
    )
    assert float(read(texts["scores.csv"])[0]["crps_kN"]) == pytest.approx(0.13344665, rel=1e-5)
    assert float(read(texts["scores.csv"])[0]["coverage_95"]) == 0.95
    assert '"unit": "kN/mm"' in texts["parameters.json"]
    assert "kN/mm" in texts["parameters.tex"]
    assert "kip" not in "".join(texts.values())


def test_json_says_what_it_holds_and_holds_what_csv_does(campaign):
    rows = (campaign.law_rows[0] | {"r_hat": math.inf, "mean": math.nan},)
    texts = report_tables(replace(campaign, law_rows=rows))

    def refuse(word):
        raise ValueError(word)

    for name in ("parameters", "laws"):
        content = json.loads(texts[f"{name}.json"], parse_constant=refuse)
        assert content["interval"]["kind"] == "equal-tailed"
        assert content["interval"]["probability"] == 0.95
        lines = read(texts[f"{name}.csv"])
        assert len(lines) == len(content["rows"]) > 0
        for row, line in zip(content["rows"], lines, strict=True):
            assert [row["unit"], row["note"]] == [line["unit"], line["note"]]
            assert [row["lower"], row["median"]] == [float(line["q2.5"]), float(line["q50"])]
    assert content["rows"][0]["r_hat"] is None
    assert content["rows"][0]["mean"] is None


def test_a_parameter_that_the_noise_decides_has_both_values_in_every_form(campaign):
    name = campaign.tests[0].id
    view = of_two(campaign, noises=(NOISE | {"test": name},))
    texts, plain = report_tables(view) | tex(view), report_tables(campaign) | tex(campaign)
    note = next(r for r in read(texts["parameters.csv"]) if r["parameter"] == "k3")["note"]
    assert note == "the noise model decides: staged: 42.2 [39.0, 45.6]"
    rows = {r["parameter"]: r for r in json.loads(texts["parameters.json"])["rows"]}
    both = {"noise": "staged", "lower": 39.0, "median": 42.2, "upper": 45.6}
    assert rows["k3"]["other_noises"] == [both]
    assert rows["Fc_fwd"]["other_noises"] == []
    assert "staged" in texts["parameters.tex"]
    assert not [text for text in plain.values() if "staged" in text]
    metric = read(report_tables(replace(view, metric=True))["noises.csv"])[0]
    assert float(metric["other_q50"]) == pytest.approx(42.2 * STIFFNESS, rel=1e-5)
    assert metric["decides"] == "yes"


def test_where_a_test_alone_and_all_together_disagree_one_mark_says_so(campaign):
    def with_joint(disagrees):
        joint = {"joint_lower": 2.0, "joint_median": 2.5, "joint_upper": 3.0}
        row = campaign.tests[0].rows[1] | joint | {"disagrees": disagrees}
        return of_two(campaign, rows=(row,))

    line = read(report_tables(with_joint(True))["parameters.csv"])[0]
    assert (line["joint_q50"], line["disagrees"]) == ("2.5", "yes")
    for disagrees in (True, False):
        (row,) = paper_sheets(with_joint(disagrees), NAMES)[0].rows
        marked = [line.text for line in row.cells[0].lines if line.marked]
        assert marked == ["with the others: 2.50 [2.00, 3.00]"] * disagrees


def metric_sheets(view):
    return [sheet.to_units(SI) for sheet in paper_sheets(replace(view, metric=True), NAMES)]


def noted(view, note="mostly the prior"):
    """Two tests; the second has a note on k3."""
    test = view.tests[0]
    rows = tuple(r | {"test": "t2", "note": note * (r["name"] == "k3")} for r in test.rows)
    return replace(view, tests=(test, replace(test, id="t2", rows=rows)))


def test_an_excel_workbook_holds_numbers(campaign):
    pytest.importorskip("openpyxl")
    sheets = metric_sheets(noted(campaign))
    named = dict(zip(("Table I", "Table II"), sheets, strict=True))
    found = pd.read_excel(io.BytesIO(to_excel(named, NAMES)), sheet_name=None)
    table = found["Table I"].set_index("quantity")
    head = f"{campaign.tests[0].id}, 5.516 MPa"
    assert table.loc["k_3", "unit"] == "kN/mm"
    for what, value in (("median", 1.0), ("2.5 %", 0.8), ("97.5 %", 1.2)):
        assert table.loc["k_3", f"{head}: {what}"] == pytest.approx(value * STIFFNESS)
    assert "mostly the prior (t2" in table.loc["k_3", "note"]
    assert found["Table II"]["all tests: median"].tolist() == pytest.approx([1.2 * 25.4**2])


def test_no_name_is_a_formula_in_excel(campaign):
    openpyxl = pytest.importorskip("openpyxl")
    view = noted(campaign, note="=HYPERLINK(1)")
    book = openpyxl.load_workbook(io.BytesIO(to_excel({"I": paper_sheets(view, NAMES)[0]}, NAMES)))
    assert not [cell for row in book["I"].rows for cell in row if cell.data_type == "f"]


def test_a_word_document_holds_both_tables_and_fits_its_page(campaign):
    docx = pytest.importorskip("docx", reason='needs the extra "word"')
    tests = [replace(campaign.tests[0], id=f"t{i}") for i in range(7)]
    rows = {t.id: tuple(r | {"test": t.id} for r in t.rows) for t in tests}
    noted_rows = tuple(r | {"note": "mostly the prior"} for r in rows["t0"])
    tests = tuple(replace(t, rows=noted_rows if t.id == "t0" else rows[t.id]) for t in tests)
    view = replace(campaign, tests=tests)
    document = docx.Document(io.BytesIO(to_word(view.title, metric_sheets(view), NAMES)))
    assert document.paragraphs[0].text == view.title
    first, *_, last = document.tables
    cells = {row.cells[0].paragraphs[0].text: row.cells for row in first.rows}
    assert cells["k3"][1].text == "kN/mm"
    assert cells["k3"][2].text == "0.175a\n[0.140, 0.210]"
    assert "a Mostly the prior." in [p.text for p in document.paragraphs]
    low = [run.text for run in cells["k3"][0].paragraphs[0].runs if run.font.subscript]
    assert low == ["3"]
    assert len(last.rows) == 1 + len(view.law_rows)
    heads = [cell.text for table in document.tables[:-1] for cell in table.rows[0].cells[2:]]
    assert [head.split(",")[0] for head in heads] == [test.id for test in tests]
    section = document.sections[0]
    room = section.page_width - section.left_margin - section.right_margin
    for table in document.tables:
        assert sum(cell.width for cell in table.rows[0].cells) == pytest.approx(room, abs=9525)
        assert "w:tblHeader" in table.rows[0]._tr.xml


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("soffice") is None, reason="no LibreOffice here")
@pytest.mark.skipif(shutil.which("pdftotext") is None, reason="no pdftotext here")
@pytest.mark.parametrize("suffix", ["docx", "xlsx"])
def test_libreoffice_opens_tables_in_kn_and_mm(campaign, tmp_path, suffix):
    one, two = metric_sheets(campaign)
    sheets = {"I": one, "II": two}
    made = to_word("a", [one, two], NAMES) if suffix == "docx" else to_excel(sheets, NAMES)
    (tmp_path / f"tables.{suffix}").write_bytes(made)
    home = f"-env:UserInstallation={(tmp_path / 'home').as_uri()}"
    words = ["soffice", home, "--headless", "--convert-to", "pdf", f"tables.{suffix}"]
    subprocess.run(words, cwd=tmp_path, check=True, capture_output=True, timeout=300)
    words = ["pdftotext", "-layout", "tables.pdf", "-"]
    text = subprocess.run(words, cwd=tmp_path, check=True, capture_output=True, text=True).stdout
    (line,) = (found for found in text.splitlines() if re.match(r"\s*k_?3\s", found))
    assert re.search(r"kN/mm\s+0\.175", line)


def test_a_data_sheet_is_the_same_in_every_form(datasheet):
    frame = datasheet_frame(datasheet.rows, SI)
    assert list(frame["actuation_unit"].unique()) == ["MPa"]
    assert frame["stroke_mm"].tolist() == [25.4] * 6
    energy = frame[frame["quantity"] == "energy"].iloc[0]
    assert energy["unit"] == "kN*mm"
    assert energy["nominal"] == pytest.approx(4.4482216 * 25.4)
    line = read(to_csv(frame))[0]
    assert (line["quantity"], line["tested"], line["n_outside"]) == ("slip_force", "yes", "1")
    sheet = datasheet_sheet(datasheet.rows, "A device", NAMES, SI.axes).to_units(SI)
    assert sheet.heads == ("c0", "c1")
    slip = sheet.rows[0]
    assert [line.text for line in slip.cells[0].shown] == [
        *("6.01", "5.78–6.23", "4.45", "3.56–5.56", "0.800–1.25")
    ]
    assert [line.marked for line in slip.cells[0].lines] == [False, True, False, False, False]
    assert [line.text for line in slip.cells[1].shown] == ["4.45", "3.56–5.56", "0.800–1.25"]
    text = to_latex("datasheet", sheet, NAMES)
    assert "no test was made there" in text
    assert r"$4.45$" in text
    book = pd.read_excel(io.BytesIO(to_excel({"s": sheet}, NAMES)))
    assert book.loc[0, f"{sheet.heads[0]}: nominal"] == pytest.approx(4.4482216)
    assert to_word("A device", [sheet], NAMES).startswith(b"PK")


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
def test_text_is_printed_in_latex_as_it_is(text, written):
    assert escape_tex(text) == written


def test_numbers_and_quantities_are_maths():
    numbers = (24.5916, -0.00091, 1.5e-9, math.inf, math.nan)
    written = ["$24.6$", "$-0.000910$", r"$1.50\times 10^{-9}$", r"$\infty$", r"$\mbox{--}$"]
    assert [number_tex(value) for value in numbers] == written
    assert symbol_tex("sigma0", NAMES) == r"$\sigma_0$"
    assert symbol_tex("exponent_Fc_fwd", NAMES) == r"exponent of $F_{c,\mathrm{fwd}}$"
    assert symbol_tex("my_own", NAMES) == "my own"


@pytest.fixture
def hostile(campaign):
    """A campaign whose every text is full of what LaTeX takes for commands."""
    test, held = campaign.tests
    rows = [r | {"note": f"{SPECIAL} γ2 ≤ ½"} for r in (*test.rows, test.rows[0])]
    rows.append(rows[0] | {"name": f"[*{SPECIAL}", "median": -1.5e-9, "upper": math.inf})
    names = [f"{SPECIAL}{i}" for i in range(4)]
    tests = [replace(test, id=n, rows=tuple(r | {"test": n} for r in rows)) for n in names]
    law = campaign.law_rows[0] | {"unit": "kip*s/in**2", "note": "[x]"}
    laws = tuple(law | {"name": f"exponent_{SPECIAL}{i}"} for i in range(30))
    title = f"{SPECIAL}\n\\input{{secret}}\r日本"
    return replace(campaign, tests=(*tests, held), law_rows=laws, title=title)


def body(text):
    return [line for line in text.splitlines() if not line.startswith("%")]


def test_latex_tables_have_a_column_for_each_test_and_are_split_where_wide(campaign):
    text = tex(noted(campaign))["parameters.tex"]
    assert text.count(r"\begin{tabular}") == 1
    assert r"$k_3$ & kip/in & $1.00$ & $1.00$$^{a}$" in text
    assert "$^{a}$ mostly the prior." in text
    assert r"equal-{}tailed 95 \% interval" in text
    tests = tuple(replace(campaign.tests[0], id=f"p{i}") for i in range(10))
    wide = tex(replace(campaign, tests=tests))["parameters.tex"]
    assert wide.count(r"\begin{tabular}") == wide.count(r"\end{table}") == 4
    assert "(4 of 4)" in wide
    empty = tex(replace(campaign, tests=(), law_rows=()))
    assert body(empty["parameters.tex"]) == body(empty["laws.tex"]) == []


def test_no_text_is_a_command_of_latex(hostile):
    texts = tex(hostile)
    for text, counts in ((texts["laws.tex"], {3}), (texts["parameters.tex"], {4})):
        lines = body(text)
        rows = [line for line in lines if line.startswith("    ") and line.endswith(r" \\")]
        assert {len(re.findall(r"(?<!\\)&", line)) + 1 for line in rows} == counts
        assert not [line for line in lines if r"\input" in line or "secret" in line]
        plain = re.sub(r"\\[\\_%&#${}]", "", "\n".join(lines))
        assert not re.search(r"[%#~]", plain)
        assert plain.count("{") == plain.count("}")
        assert plain.count("$") % 2 == 0


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="no LaTeX here")
@pytest.mark.parametrize("broken", [False, True])
def test_latex_typesets_the_tables(hostile, tmp_path, broken, monkeypatch):
    if broken:  # the control: LaTeX does mind what is not escaped
        monkeypatch.setattr(tables, "_ESCAPED", {})
    for name in ("parameters.tex", "laws.tex"):
        (tmp_path / name).write_text(tex(hostile)[name], encoding="utf-8")
    (tmp_path / "main.tex").write_text(DOCUMENT)
    words = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "main.tex"]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, check=False, timeout=120)
    assert (done.returncode != 0) == broken, done.stdout.decode(errors="replace")[-2000:]


def test_the_table_of_a_record_has_every_sample(campaign):
    test = campaign.tests[0]
    stage, travel = np.full(test.trace.samples, 2, np.int8), np.zeros(test.trace.samples)
    frame = pd.read_csv(io.StringIO(record_table(replace(test, stage=stage, travel=travel))))
    assert len(frame) == test.trace.samples
    np.testing.assert_allclose(frame["force_kip"], test.trace.force, rtol=1e-5, atol=1e-9)
    residual = test.trace.force - test.observation.median
    np.testing.assert_allclose(frame["residual_kip"], residual, rtol=1e-4, atol=1e-6)
    assert (frame["lower_95_kip"] <= frame["lower_50_kip"]).all()
    assert "model_lower_95_kip" in frame
    assert frame["fitted"].sum() == test.trace.samples - test.first
    assert frame["stage"].eq(2).all()
    held = pd.read_csv(io.StringIO(record_table(campaign.tests[1], SI)))
    assert held["fitted"].eq(0).all()
    assert "velocity_mm_per_s" in held
    assert held["force_kN"][0] == pytest.approx(
        4.4482216 * campaign.tests[1].trace.force[0], rel=1e-5
    )


def test_tables_behind_the_figures_of_all_tests(campaign):
    named = replace(campaign.tests[0], id="=HYPERLINK(1)")
    texts = dict(shared_tables(replace(campaign, tests=(named,), metric=True)))
    assert set(texts) == {f"figures/{name}.csv" for name in ("overview", "laws", "truth")}
    assert "\n'=HYPERLINK(1)" in texts["figures/overview.csv"]
    rows = read(texts["figures/laws.csv"])
    assert {row["what"] for row in rows} == {
        *("mean property, 95 %", "this device tested again, 95 %"),
        *("test a, 95 %", "test b, 95 %"),
    }
    assert {row["unit"] for row in rows} == {"kN"}
    assert all(float(r["lower"]) <= float(r["median"]) <= float(r["upper"]) for r in rows)
