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
from mfd_bayes.jobs.job import Step
from mfd_bayes.reporting.publish import PLAIN, Forms, publish
from mfd_bayes.reporting.symbols import Symbols
from mfd_bayes.reporting.tables import (
    datasheet_frame,
    paper_sheets,
    predicted_csv,
    record_table,
    shared_tables,
    to_latex,
)
from mfd_bayes.runs.folder import discard
from mfd_bayes.runs.manifest import Verdict
from mfd_bayes.runs.unit_system import SI

STIFFNESS = 4.4482216 / 25.4  # kN/mm of a kip/in
SPECIAL = r"a_b%c&d#e$f\g{h}i~j^k|l<m>"
DOCUMENT = r"""\documentclass{article}
\usepackage{booktabs,longtable,array}
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


@pytest.fixture
def files(tmp_path, no_figures):
    """Texts and bytes of all tables of a report, as they are written, by the file's name."""

    def write(view, sheet=None, forms=PLAIN):
        publish(view, tmp_path, 1, lambda step: Step, forms, sheet)
        paths = [p for p in tmp_path.iterdir() if p.suffix in (".csv", ".json", ".tex")]
        return {p.name: p.read_text() for p in paths}

    return write


def read(text):
    return list(csv.DictReader(io.StringIO(text)))


def of_two(view, **changes):
    """The view with its first test changed, and the second as it is."""
    return replace(view, tests=(replace(view.tests[0], **changes), *view.tests[1:]))


def test_values_are_those_of_the_report_under_their_columns(campaign, files):
    texts = files(campaign)
    for name, columns in COLUMNS.items():
        first = texts[f"{name}.csv"].splitlines()[0].split(",")
        assert first[: len(columns.split())] == columns.split()
    assert float(read(texts["parameters.csv"])[1]["q97.5"]) == 1.2
    assert [line["role"] for line in read(texts["scores.csv"])] == ["calibrate", "validate"]
    derived = read(texts["derived.csv"])
    assert [line["measured"] for line in derived][:3] == ["3.3", "1.4", ""]
    assert derived[3]["q50"] == ""  # no full cycle
    assert [line["test"] for line in read(texts["crossvalidation.csv"])] == ["p800_f0.25", "mean"]
    assert [line["chosen"] for line in read(texts["law_scores.csv"])] == ["no", "yes"]


def test_a_prediction_says_what_it_is(campaign):
    about, other, *table = predicted_csv(campaign.tests[0].derived, "800 psi", 0.9).splitlines()
    assert "90 % intervals" in about
    assert other.startswith("# actuation 800 psi")
    assert read("\n".join(table))[0]["quantity"] == "energy_per_cycle"


def test_a_new_run_in_a_folder_removes_every_table_of_the_old_one(
    campaign, datasheet, files, tmp_path
):
    files(replace(campaign, left_out=None, truth=()), datasheet, Forms(word=True, excel=True))
    (tmp_path / "manifest.json").write_text("{}")
    discard(tmp_path)
    assert [path.name for path in tmp_path.iterdir() if path.is_file()] == []


def test_no_text_is_a_formula_in_csv_or_excel(campaign, files, tmp_path):
    openpyxl = pytest.importorskip("openpyxl")
    texts = ["=1+1", "-1", "\t@SUM(A1)"]
    row = {"mean": -1.25e-7, "r_hat": math.nan}
    rows = tuple(campaign.law_rows[0] | row | {"test": text, "note": text} for text in texts)
    check = Check(texts[0], "a, b", 'say "x"', -1.0, 1.0, Verdict.PASS)
    view = replace(campaign, law_rows=rows, checks=(check,))
    written = files(view, forms=Forms(excel=True))
    for line, text in zip(read(written["laws.csv"]), texts, strict=True):
        assert line["group"] == line["note"] == f"'{text}".replace("\t", " ")
        assert (line["mean"], line["r_hat"]) == ("-1.25e-07", "")
    found = read(written["checks.csv"])[0]
    assert (found["check"], found["feature"], found["observed"]) == ("a, b", 'say "x"', "-1")
    book = openpyxl.load_workbook(tmp_path / "tables.xlsx")
    assert not [cell for row in book["laws"].rows for cell in row if cell.data_type == "f"]


def test_every_table_of_a_metric_report_is_in_kn_and_mm(campaign, files, tmp_path):
    name = campaign.tests[0].id
    view = of_two(campaign, loop_estimates=(ESTIMATE | {"test": name},))
    texts = files(replace(view, metric=True), forms=Forms(excel=True))
    row = next(r for r in read(texts["parameters.csv"]) if r["parameter"] == "k3")
    assert row["unit"] == "kN/mm"
    assert float(row["q50"]) == pytest.approx(STIFFNESS, rel=1e-5)
    estimate = float(read(texts["loop_estimates.csv"])[0]["loop_estimate"])
    assert estimate == pytest.approx(14.25 * STIFFNESS, rel=1e-5)
    assert float(read(texts["scores.csv"])[0]["crps_kN"]) == pytest.approx(0.13344665, rel=1e-5)
    assert float(read(texts["scores.csv"])[0]["coverage_95"]) == 0.95
    assert '"unit": "kN/mm"' in texts["parameters.json"]
    assert "kN/mm" in texts["parameters.tex"]
    assert "kip" not in "".join(texts.values())
    sheets = pd.read_excel(tmp_path / "tables.xlsx", sheet_name=None)
    table = sheets["parameters"].set_index(["test", "parameter"])
    assert table.loc[(name, "k3"), "q50"] == pytest.approx(STIFFNESS, rel=1e-6)
    assert sheets["laws"]["q50"].tolist() == pytest.approx([1.2 * 25.4**2])


def test_json_says_what_it_holds_and_holds_what_csv_does(campaign, files):
    rows = (campaign.law_rows[0] | {"r_hat": math.inf, "mean": math.nan},)
    texts = files(replace(campaign, law_rows=rows))

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


def test_what_the_noise_or_the_other_tests_decide_stands_beside_the_value(campaign, files):
    name = campaign.tests[0].id
    joint = {"joint_lower": 2.0, "joint_median": 2.5, "joint_upper": 3.0, "disagrees": True}
    rows = (campaign.tests[0].rows[0], campaign.tests[0].rows[1] | joint)
    view = of_two(campaign, noises=(NOISE | {"test": name},), rows=rows)
    plain, texts = files(campaign), files(view)
    other, row = read(texts["parameters.csv"])
    assert (other["note"], other["disagrees"]) == ("", "no")
    assert "noise model decides" in row["note"]
    assert (row["joint_q50"], row["disagrees"]) == ("2.5", "yes")
    assert "staged: 42.2 {[}39.0, 45.6]" in texts["parameters.tex"]
    assert "with the others: 2.50 {[}2.00, 3.00]" in texts["parameters.tex"]
    assert not [text for text in plain.values() if "staged" in text or "with the others" in text]
    metric = read(files(replace(view, metric=True))["noises.csv"])[0]
    assert float(metric["other_q50"]) == pytest.approx(42.2 * STIFFNESS, rel=1e-5)
    assert metric["decides"] == "yes"


def test_a_word_document_holds_both_tables(campaign, files, tmp_path):
    docx = pytest.importorskip("docx", reason='needs the extra "word"')
    rows = {f"t{i}": campaign.tests[0].rows for i in range(7)}
    rows["t0"] = tuple(row | {"note": "mostly the prior"} for row in rows["t0"])
    tests = tuple(
        replace(campaign.tests[0], id=name, rows=tuple(row | {"test": name} for row in own))
        for name, own in rows.items()
    )
    files(replace(campaign, tests=tests, metric=True), forms=Forms(word=True))
    document = docx.Document(tmp_path / "tables.docx")
    assert document.paragraphs[0].text == campaign.title
    first, *_, last = document.tables
    cells = {row.cells[0].paragraphs[0].text: row.cells for row in first.rows}
    assert cells["k3"][1].text == "kN/mm"
    assert cells["k3"][2].text == "0.175\n[0.140, 0.210] 1"
    assert "1 mostly the prior." in [p.text for p in document.paragraphs]
    low = [run.text for run in cells["k3"][0].paragraphs[0].runs if run.font.subscript]
    assert low == ["3"]
    assert len(last.rows) == 1 + len(campaign.law_rows)
    heads = [cell.text for table in document.tables[:-1] for cell in table.rows[0].cells[2:]]
    assert [head.split(",")[0] for head in heads] == list(rows)


def test_a_data_sheet_is_the_same_in_every_form(campaign, datasheet, files):
    frame = datasheet_frame(datasheet.rows, SI)
    assert list(frame["actuation_unit"].unique()) == ["MPa"]
    assert frame["stroke_mm"].tolist() == [25.4] * 6
    energy = frame[frame["quantity"] == "energy"].iloc[0]
    assert energy["unit"] == "kN*mm"
    assert energy["nominal"] == pytest.approx(4.4482216 * 25.4)
    texts = files(replace(campaign, metric=True), datasheet)
    line = read(texts["datasheet.csv"])[0]
    assert (line["quantity"], line["tested"], line["n_outside"]) == ("slip_force", "yes", "1")
    assert float(line["nominal"]) == pytest.approx(4.4482216)
    for shown in ("6.01", "5.78--6.23", "4.45", "3.56--5.56", "0.800--1.25"):
        assert shown in texts["datasheet.tex"]
    assert r"no test was made there.\par" in texts["datasheet.tex"]


def latex(view):
    one, two = paper_sheets(view, NAMES)
    return to_latex("parameters", one, NAMES), to_latex("laws", two, NAMES)


@pytest.fixture
def hostile(campaign):
    """A campaign whose every text is full of what LaTeX takes for commands."""
    test, held = campaign.tests
    rows = [r | {"note": f"{SPECIAL} γ2 ≤ ½ [x] --"} for r in (*test.rows, test.rows[0])]
    rows.append(rows[0] | {"name": f"[*{SPECIAL}", "median": -1.5e-9, "upper": math.inf})
    names = [f"{SPECIAL}{i}" for i in range(4)]
    tests = [replace(test, id=n, rows=tuple(r | {"test": n} for r in rows)) for n in names]
    law = campaign.law_rows[0] | {"unit": "kip*s/in**2", "note": "[x]"}
    laws = tuple(law | {"name": f"exponent_{SPECIAL}{i}"} for i in range(30))
    title = f"{SPECIAL}\n\\input{{secret}}\r日本"
    return replace(campaign, tests=(*tests, held), law_rows=laws, title=title)


def test_latex_has_a_column_for_each_test_and_no_text_is_a_command(campaign, hostile):
    tests = tuple(replace(campaign.tests[0], id=f"p{i}") for i in range(10))
    text = latex(replace(campaign, tests=tests))[0]
    assert text.count(r"\begin{longtable}") == text.count(r"\end{longtable}") == 4
    assert re.search(r"\$k_3\$.* & kip/in & 1\.00\\newline", latex(campaign)[0])
    empty = latex(replace(campaign, tests=(), law_rows=()))
    assert [line for line in "".join(empty).splitlines() if line and not line.startswith("%")] == []
    for text, counts in zip(latex(hostile), ({4}, {3}), strict=True):
        lines = [line for line in text.splitlines() if not line.startswith("%")]
        rows = [line for line in lines if " & " in line]
        assert {len(re.findall(r"(?<!\\)&", line)) + 1 for line in rows} == counts
        assert not [line for line in lines if r"\input" in line or "secret" in line]
        plain = re.sub(r"\\[\\_%&#${}]", "", "\n".join(lines))
        assert not re.search(r"[%#~]", plain)
        assert plain.count("{") == plain.count("}")
        assert plain.count("$") % 2 == 0
        assert text.isascii()


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="no LaTeX here")
def test_latex_typesets_the_tables(hostile, tmp_path):
    for name, text in zip(("parameters.tex", "laws.tex"), latex(hostile), strict=True):
        (tmp_path / name).write_text(text, encoding="utf-8")
    (tmp_path / "main.tex").write_text(DOCUMENT)
    words = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "main.tex"]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, check=False, timeout=120)
    assert done.returncode == 0, done.stdout.decode(errors="replace")[-2000:]


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
    first = 4.4482216 * campaign.tests[1].trace.force[0]
    assert held["force_kN"][0] == pytest.approx(first, rel=1e-5)


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
