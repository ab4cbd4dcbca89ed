"""Tables I and II as Word and Excel files, opened by the readers that others use, and as text."""

import csv
import io
import itertools
import re
import shutil
import subprocess
from dataclasses import replace

import pandas as pd
import pytest

from mfd_bayes.errors import ReportError
from mfd_bayes.evaluation.views import ReadingRow
from mfd_bayes.reporting import word
from mfd_bayes.reporting.conversion import in_tables
from mfd_bayes.reporting.exports import export_tables
from mfd_bayes.reporting.figure_data import shared_tables, tables_of_test
from mfd_bayes.reporting.paper_tables import check_library, paper_tables, symbol_of
from mfd_bayes.reporting.tables import report_tables
from mfd_bayes.reporting.workbook import excel_tables
from mfd_bayes.runs.systems import SI

STIFFNESS = 4.4482216 / 25.4  # kN/mm of a kip/in


@pytest.fixture(scope="module")
def metric(campaign):
    """The report as a metric campaign has it."""
    return in_tables(replace(campaign, metric=True), SI)


def sheets(view):
    return pd.read_excel(io.BytesIO(excel_tables(view)), sheet_name=None)


def row_of(text, **wanted):
    """The one row of a CSV table with these cells."""
    (found,) = (
        row
        for row in csv.DictReader(io.StringIO(text))
        if all(row[k] == v for k, v in wanted.items())
    )
    return found


def test_a_symbol_has_its_subscript():
    assert symbol_of("Fc_fwd").text == "F_c,fwd"
    assert symbol_of("k3").parts[-1] == ("3", True)


def test_an_excel_workbook_holds_numbers_in_kn_and_mm(metric, campaign):
    found = sheets(metric)
    assert list(found) == ["Table I", "Table II"]
    table = found["Table I"].set_index("quantity")
    test = campaign.tests[0]
    head = f"{test.id}, 5.516 MPa"
    assert table.loc["k_3", "unit"] == "kN/mm"
    for what, figure in (("median", 1.0), ("2.5 %", 0.8), ("97.5 %", 1.2)):
        assert table.loc["k_3", f"{head}: {what}"] == pytest.approx(figure * STIFFNESS)
    laws = found["Table II"]
    assert laws["all tests: median"].tolist() == pytest.approx([1.2 * 25.4**2])


def test_no_table_of_a_metric_report_is_in_kip(campaign):
    read = ReadingRow(campaign.tests[0].id, "k3", "kip/in", 14.25, 0.8, 1.0, 1.2, 0.3, missed=True)
    tests = (replace(campaign.tests[0], readings=(read,)), *campaign.tests[1:])
    shown = in_tables(replace(campaign, metric=True, tests=tests), SI)
    found = report_tables(shown, SI)
    row = row_of(found["readings.csv"], quantity="k3")
    assert row["unit"] == "kN/mm"
    assert float(row["read_off"]) == pytest.approx(14.25 * STIFFNESS, rel=1e-5)
    assert not [name for name, text in found.items() if ",kip" in text or "_kip" in text]


def test_no_name_is_a_formula_in_excel(campaign):
    openpyxl = pytest.importorskip("openpyxl")
    test = replace(campaign.tests[0], id="=HYPERLINK(1)")
    book = openpyxl.load_workbook(io.BytesIO(excel_tables(replace(campaign, tests=(test,)))))
    heads = book["Table I"][1]
    assert heads[3].value.startswith("=HYPERLINK(1)")
    assert heads[3].data_type == "s"


def test_a_word_document_holds_both_tables_in_kn_and_mm(metric):
    docx = pytest.importorskip("docx", reason='needs the extra "word"')
    from mfd_bayes.reporting.word import word_tables

    document = docx.Document(io.BytesIO(word_tables(metric)))
    assert document.paragraphs[0].text == metric.title
    first, *_, last = document.tables
    cells = {row.cells[0].paragraphs[0].text: row.cells for row in first.rows}
    assert cells["k3"][1].text == "kN/mm"
    assert cells["k3"][2].text == "0.175\n[0.140, 0.210]"
    low = [run.text for run in cells["k3"][0].paragraphs[0].runs if run.font.subscript]
    assert low == ["3"]
    assert len(last.rows) == 1 + len(metric.law_rows)
    titles = [p.text for p in document.paragraphs if p.style.name == "Caption"]
    assert [title.split(":")[0] for title in titles] == ["Table I", "Table II"]


def test_many_tests_are_split_among_tables(campaign):
    docx = pytest.importorskip("docx", reason='needs the extra "word"')
    from mfd_bayes.reporting.word import word_tables

    tests = tuple(replace(campaign.tests[0], id=f"t{i}") for i in range(7))
    document = docx.Document(io.BytesIO(word_tables(replace(campaign, tests=tests))))
    heads = [cell.text for table in document.tables[:-1] for cell in table.rows[0].cells[2:]]
    assert [head.split(",")[0] for head in heads] == [test.id for test in tests]
    assert max(len(table.columns) for table in document.tables) == 5


def noted(campaign):
    """Two tests; the second has a note on k3."""
    test = campaign.tests[0]
    rows = tuple(replace(r, note="mostly the prior" * (r.name == "k3")) for r in test.rows)
    other = replace(test, id="t2", rows=tuple(replace(row, subject="t2") for row in rows))
    return replace(campaign, tests=(test, other))


def test_a_note_in_word_has_the_letter_of_its_value(campaign):
    docx = pytest.importorskip("docx", reason='needs the extra "word"')
    from mfd_bayes.reporting.word import word_tables

    document = docx.Document(io.BytesIO(word_tables(noted(campaign))))
    cells = {row.cells[0].paragraphs[0].text: row.cells for row in document.tables[0].rows}
    marks = [[r.text for r in c.paragraphs[0].runs if r.font.superscript] for c in cells["k3"]]
    assert marks[3] != marks[2]
    assert f"{marks[3][0]} Mostly the prior." in [p.text for p in document.paragraphs]


def test_no_note_in_word_is_without_a_mark():
    marks = list(itertools.islice(word._marks(), 60))
    assert marks[:2] + marks[25:28] == ["a", "b", "z", "aa", "ab"]
    assert len(set(marks)) == 60


def test_a_note_in_excel_names_its_tests(campaign):
    table = sheets(noted(campaign))["Table I"].set_index("quantity")
    assert "mostly the prior (t2)" in table.loc["k_3", "note"]


def test_word_tables_fit_their_page(campaign):
    docx = pytest.importorskip("docx", reason='needs the extra "word"')
    from mfd_bayes.reporting.word import word_tables

    tests = tuple(replace(campaign.tests[0], id=f"t{i}") for i in range(4))
    document = docx.Document(io.BytesIO(word_tables(replace(campaign, tests=tests))))
    section = document.sections[0]
    room = section.page_width - section.left_margin - section.right_margin
    for table in document.tables:
        assert sum(cell.width for cell in table.rows[0].cells) == pytest.approx(room, abs=9525)
        assert "w:tblHeader" in table.rows[0]._tr.xml


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("soffice") is None, reason="no LibreOffice here")
@pytest.mark.skipif(shutil.which("pdftotext") is None, reason="no pdftotext here")
@pytest.mark.parametrize("suffix", ["docx", "xlsx"])
def test_libreoffice_opens_tables_in_kn_and_mm(metric, tmp_path, suffix):
    pytest.importorskip("docx", reason='needs the extra "word"')
    from mfd_bayes.reporting.word import word_tables

    made = word_tables if suffix == "docx" else excel_tables
    (tmp_path / f"tables.{suffix}").write_bytes(made(metric))
    home = f"-env:UserInstallation={(tmp_path / 'home').as_uri()}"
    words = ["soffice", home, "--headless", "--convert-to", "pdf", f"tables.{suffix}"]
    subprocess.run(words, cwd=tmp_path, check=True, capture_output=True, timeout=300)
    words = ["pdftotext", "-layout", "tables.pdf", "-"]
    text = subprocess.run(words, cwd=tmp_path, check=True, capture_output=True, text=True).stdout
    (line,) = (found for found in text.splitlines() if re.match(r"\s*k_?3\s", found))
    assert re.search(r"kN/mm\s+0\.175", line)
    assert "all tests" in text


def test_notes_stand_under_a_table_once(campaign):
    test = campaign.tests[0]
    noted = replace(test, rows=tuple(replace(row, note="mostly the prior") for row in test.rows))
    table, _ = paper_tables(replace(campaign, tests=(noted,)))
    assert table.notes == ("mostly the prior",)


def test_a_missing_library_is_refused_with_its_extra():
    with pytest.raises(ReportError, match=r"needs nothing_like_it.*mfd_bayes\[word\]"):
        check_library("nothing_like_it", "word")


def test_csv_json_and_latex_are_in_the_units_of_the_campaign(metric, campaign):
    tables = report_tables(metric, SI)
    test = campaign.tests[0].id
    row = row_of(tables["parameters.csv"], test=test, parameter="k3")
    assert row["unit"] == "kN/mm"
    assert float(row["q50"]) == pytest.approx(STIFFNESS, rel=1e-5)
    score = row_of(tables["scores.csv"], test=test)
    assert float(score["crps_kN"]) == pytest.approx(0.03 * 4.4482216, rel=1e-5)
    assert float(score["coverage_95"]) == 0.95
    left_out = row_of(tables["crossvalidation.csv"], test="p800_f0.25")
    assert float(left_out["fitted_crps_kN"]) == pytest.approx(0.03 * 4.4482216, rel=1e-5)
    assert '"unit": "kN/mm"' in export_tables(metric)["parameters.json"]
    assert "kN/mm" in export_tables(metric)["parameters.tex"]
    assert "kip" not in "".join(tables.values()).replace("kip*s", "")


def test_tables_behind_figures_are_in_the_units_of_the_figures(campaign):
    from mfd_bayes.reporting.conversion import convert_test

    plain, shown = campaign.tests[0], convert_test(campaign.tests[0], SI, "ksi")
    texts = dict(tables_of_test(shown, SI)), dict(tables_of_test(plain))
    metric, us = (
        next(csv.DictReader(io.StringIO(t[f"tests/{plain.id}/record.csv"]))) for t in texts
    )
    assert float(metric["force_kN"]) == pytest.approx(4.4482216 * float(us["force_kip"]), rel=1e-5)
    assert "velocity_mm_per_s" in metric
    laws = dict(shared_tables(replace(campaign, metric=True)))["figures/laws.csv"]
    assert next(csv.DictReader(io.StringIO(laws)))["unit"] == "kN"
