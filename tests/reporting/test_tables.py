"""Tables for other programs and for papers, opened by the readers that others use."""

import csv
import io
import json
import math
import re
import shutil
import subprocess
from dataclasses import replace

import pandas as pd
import pytest

from mfd_bayes.applications.prediction.command import predicted_csv
from mfd_bayes.evaluation.assessment import Check
from mfd_bayes.runs.findings import CheckStatus

KIP = 4.4482216  # kN
SPECIAL = r"a_b%c&d#e$f\g{h}i~j^k|l<m>"
DOCUMENT = r"""\documentclass{article}
\usepackage{booktabs,longtable,array}
\begin{document}
\input{parameters.tex}
\input{laws.tex}
\end{document}
"""


def read(text):
    return list(csv.DictReader(io.StringIO(text)))


def of_two(view, **changes):
    """The view with its first test changed, and the second as it is."""
    return replace(view, tests=(replace(view.tests[0], **changes), *view.tests[1:]))


def test_a_prediction_says_what_it_is(campaign):
    title, condition, *table = predicted_csv(campaign.tests[0].derived, "800 psi", 0.9).splitlines()
    assert "90 % intervals" in title
    assert condition.startswith("# actuation 800 psi")
    assert read("\n".join(table))[0]["quantity"] == "energy_per_cycle"


def test_no_text_is_a_formula_in_csv_or_excel(campaign, written, tmp_path):
    openpyxl = pytest.importorskip("openpyxl")
    texts = ["=1+1", "-1", "\t@SUM(A1)"]
    row = {"mean": -1.25e-7, "r_hat": math.nan}
    rows = tuple(campaign.law_rows[0] | row | {"test": text, "note": text} for text in texts)
    check = Check(texts[0], "a, b", 'say "x"', -1.0, 1.0, CheckStatus.PASS)
    files = written(replace(campaign, law_rows=rows, checks=(check,)), excel=True)
    for line, text in zip(read(files["laws.csv"]), texts, strict=True):
        assert line["group"] == line["note"] == f"'{text}".replace("\t", " ")
        assert (line["mean"], line["r_hat"]) == ("-1.25e-07", "")
    entry = read(files["checks.csv"])[0]
    assert (entry["check"], entry["feature"], entry["observed"]) == ("a, b", 'say "x"', "-1")
    book = openpyxl.load_workbook(tmp_path / "tables.xlsx")
    assert not [cell for row in book["laws"].rows for cell in row if cell.data_type == "f"]


def test_json_says_what_it_holds_and_holds_what_csv_does(campaign, written):
    rows = (campaign.law_rows[0] | {"r_hat": math.inf, "mean": math.nan},)
    texts = written(replace(campaign, law_rows=rows))
    for name in ("parameters", "laws"):
        content = json.loads(texts[f"{name}.json"], parse_constant=pytest.fail)
        assert content["interval"]["kind"] == "equal-tailed"
        assert content["interval"]["probability"] == 0.95
        lines = read(texts[f"{name}.csv"])
        assert len(lines) == len(content["rows"]) > 0
        for row, line in zip(content["rows"], lines, strict=True):
            assert [row["unit"], row["note"]] == [line["unit"], line["note"]]
            assert [row["lower"], row["median"]] == [float(line["q2.5"]), float(line["q50"])]
    assert content["rows"][0]["r_hat"] is None
    assert content["rows"][0]["mean"] is None


def test_a_word_document_holds_both_tables(campaign, written, tmp_path):
    docx = pytest.importorskip("docx", reason='needs the extra "word"')
    rows = tuple(row | {"note": "mostly the prior"} for row in campaign.tests[0].rows)
    written(replace(of_two(campaign, rows=rows), metric=True), word=True)
    document = docx.Document(tmp_path / "tables.docx")
    assert document.paragraphs[0].text == campaign.title
    parameter_table, law_table = document.tables
    cells = {row.cells[0].paragraphs[0].text: row.cells for row in parameter_table.rows}
    assert cells["k3"][1].text == "kN/mm"
    assert cells["k3"][2].text == "0.175\n[0.140, 0.210] 1"
    assert "1 mostly the prior." in [p.text for p in document.paragraphs]
    low = [run.text for run in cells["k3"][0].paragraphs[0].runs if run.font.subscript]
    assert low == ["3"]
    assert len(law_table.rows) == 1 + len(campaign.law_rows)


def test_a_data_sheet_is_the_same_in_every_form(campaign, datasheet, written):
    texts = written(replace(campaign, metric=True), datasheet)
    table = pd.read_csv(io.StringIO(texts["datasheet.csv"]))
    assert list(table["actuation_unit"].unique()) == ["MPa"]
    assert table["stroke_mm"].tolist() == [25.4] * 6
    energy = table[table["quantity"] == "energy"].iloc[0]
    assert energy["unit"] == "kN*mm"
    assert energy["nominal"] == pytest.approx(KIP * 25.4, rel=1e-5)
    line = table.iloc[0]
    assert (line["quantity"], line["tested"], line["n_outside"]) == ("slip_force", "yes", 1)
    assert line["nominal"] == pytest.approx(KIP, rel=1e-5)
    for number in ("6.01", "5.78--6.23", "4.45", "3.56--5.56"):
        assert number in texts["datasheet.tex"]
    assert r"no test was made there.\par" in texts["datasheet.tex"]


# --- LaTeX


@pytest.fixture
def hostile(campaign):
    test, validation = campaign.tests
    rows = [r | {"note": f"{SPECIAL} γ2 ≤ ½ [x] --"} for r in (*test.rows, test.rows[0])]
    rows.append(rows[0] | {"name": f"[*{SPECIAL}", "median": -1.5e-9, "upper": math.inf})
    names = [f"{SPECIAL}{i}" for i in range(4)]
    tests = [replace(test, id=n, rows=tuple(r | {"test": n} for r in rows)) for n in names]
    law = campaign.law_rows[0] | {"unit": "kip*s/in**2", "note": "[x]"}
    laws = tuple(law | {"name": f"exponent_{SPECIAL}{i}"} for i in range(30))
    title = f"{SPECIAL}\n\\input{{secret}}\r日本"
    return replace(campaign, tests=(*tests, validation), law_rows=laws, title=title)


def test_latex_has_a_column_for_each_test_and_no_text_is_a_command(campaign, hostile, written):
    assert re.search(r"\$k_3\$.* & kip/in & 1\.00\\newline", written(campaign)["parameters.tex"])
    texts = written(hostile)
    for name, columns in (("parameters.tex", 4), ("laws.tex", 3)):
        text = texts[name]
        assert text.count(r"\begin{longtable}") == text.count(r"\end{longtable}") >= 1
        lines = [line for line in text.splitlines() if not line.startswith("%")]
        rows = [line for line in lines if " & " in line]
        assert {len(re.findall(r"(?<!\\)&", line)) + 1 for line in rows} == {columns}
        assert not [line for line in lines if r"\input" in line or "secret" in line]
        unescaped = re.sub(r"\\[\\_%&#${}]", "", "\n".join(lines))
        assert not re.search(r"[%#~]", unescaped)
        assert unescaped.count("{") == unescaped.count("}")
        assert unescaped.count("$") % 2 == 0
        assert text.isascii()


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="no LaTeX here")
def test_latex_typesets_the_tables(hostile, written, tmp_path):
    written(hostile)
    (tmp_path / "main.tex").write_text(DOCUMENT)
    words = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "main.tex"]
    process = subprocess.run(words, cwd=tmp_path, capture_output=True, check=False, timeout=120)
    assert process.returncode == 0, process.stdout.decode(errors="replace")[-2000:]
