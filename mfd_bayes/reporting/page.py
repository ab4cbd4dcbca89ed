"""Pages of a report."""

from __future__ import annotations

import base64
import hashlib
import json
import math
import os
import re
import shutil
import subprocess
import tempfile
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from functools import cache, partial
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from mfd_bayes.calibration.noises import NOISES
from mfd_bayes.calibration.sensitivity import Follows
from mfd_bayes.errors import ReportError
from mfd_bayes.evaluation.assessment import FREE_EXPONENT
from mfd_bayes.evaluation.scores import Rows, width_sentence
from mfd_bayes.evaluation.sensitivity import sentences, summaries
from mfd_bayes.evaluation.views import CampaignView, Datasheet, TestView
from mfd_bayes.jobs.job import JobState, Step
from mfd_bayes.jobs.local import several_processes
from mfd_bayes.messages import Measure, Message
from mfd_bayes.reporting import symbols
from mfd_bayes.reporting.options import ReportOptions
from mfd_bayes.reporting.symbols import BANDS, DATA, SKY, Symbols
from mfd_bayes.reporting.tables import (
    ACTUATION,
    Line,
    datasheet_frame,
    datasheet_sheet,
    frame_of,
    paper_sheets,
    record_table,
    report_frames,
    score_sheet,
    shared_tables,
    table_of,
    to_csv,
    to_excel,
    to_json,
    to_latex,
    to_units,
    to_word,
    with_motion,
)
from mfd_bayes.runs.unit_system import UnitSystem
from mfd_bayes.store.files import write_bytes, write_text
from mfd_bayes.units import DAMPER, in_digits

Pair = tuple[UnitSystem, UnitSystem]
"""Customary and metric system of units."""

ELSEWHERE = frozenset(
    {
        *("gamma1", "gamma2", "start", "offset", "static_excess_fwd", "static_excess_bwd"),
        *(q.name for noise in NOISES.values() for q in noise.quantities),
    }
)
"""Quantities that the tests' own pages show: those of a record, and those without a meaning."""

WORDS = (
    *("95\N{NO-BREAK SPACE}% interval", "Mean property (band of kind mean)", "Coverage", "CRPS"),
    "This device tested again (band of kind new_test)",
    "A measurement of it (band of kind observation)",
    "This very test (band of kind this_test)",
    "Bounding properties",
)
"""Words of the glossary that the page explains."""

CONDITIONS = 12
"""Most columns of the data sheet side by side on its page."""


def picture(key: str, png: bytes, *, embedded: bool = True) -> dict[str, Any]:
    """A PNG as a page shows it, part of a page in the run folder or beside its page.

    `uri` is the embedded PNG, or its path; `width` and `height` are in pixels; `png` and `csv` are
    the paths from the page to the picture and to the table behind it.
    """
    path, table = key if "/" in key else f"figures/{key}", table_of(key)
    if not embedded:
        path, table = path.rpartition("/")[2], table.rpartition("/")[2]
    path = quote(f"{path}.png")
    uri = f"data:image/png;base64,{base64.b64encode(png).decode('ascii')}" if embedded else path
    # width and height are in the first chunk of a PNG
    width, height = (int.from_bytes(png[offset : offset + 4], "big") for offset in (16, 20))
    return {"uri": uri, "width": width, "height": height, "png": path, "csv": quote(table)}


def _factor_and_name(unit: str, system: UnitSystem) -> tuple[float, str]:
    if unit.startswith(ACTUATION):
        return system.of_actuation(unit.removeprefix(ACTUATION))
    return system.factor(unit), symbols.unit_text(system.unit(unit))


@dataclass
class Units:
    """Numbers and units of one page, as its script can change them.

    The page begins with the second of its systems, customary and metric, where it is `metric`.
    `convert` gives factor and name of an internal unit in a system, `words` is how quantities are
    written, and `conversions` has factor and name in each system of every unit on the page so far.
    """

    systems: Pair
    metric: bool = False
    convert: Callable[[str, UnitSystem], tuple[float, str]] = _factor_and_name
    words: symbols.Symbols = field(default_factory=symbols.Symbols)
    conversions: dict[str, dict[str, tuple[float, str]]] = field(default_factory=dict)

    def _own(self, unit: str) -> tuple[float, str]:
        of = {system.name: self.convert(unit, system) for system in self.systems}
        self.conversions[unit] = of
        return of[self.systems[self.metric].name]

    def number(self, value: float, unit: str, digits: int = 3, *, short: bool = False) -> Markup:
        """A number that is stored in an internal unit; a short one without zeros at its end."""
        factor, _ = self._own(unit)
        text = symbols.number(value * factor, digits)
        if not math.isfinite(value):
            return Markup(escape(text))
        if short:
            text = in_digits(value * factor, digits).replace("-", "−")
        span = Markup('<span data-value="{:.7g}" data-unit="{}" data-digits="{}"{}>{}</span>')
        return span.format(value, unit, digits, Markup(" data-short" * short), text)

    def name(self, unit: str) -> Markup:
        """The name of an internal unit; empty for none."""
        _, text = self._own(unit)
        return Markup('<span data-unit="{}">{}</span>').format(unit, text) if text else Markup()

    def values(self, values: Sequence[float], unit: str, digits: int = 3) -> Markup:
        """One value, or the ends of a range, with their unit: "500 to 1500 psi"."""
        factor, _ = self._own(unit)
        texts = {
            in_digits(v * factor, digits): self.number(v, unit, digits, short=True) for v in values
        }
        text_range = Markup(" to ").join(texts.values())
        return (
            Markup("{} {}").format(text_range, self.name(unit))
            if self._own(unit)[1]
            else text_range
        )

    def line(self, line: Line, unit: str) -> Markup:
        """A line of a cell of a sheet."""
        digits = [self.number(value, unit) for value in line.numbers]
        return Markup(escape(line.template)).format(*digits)

    def level(self, test: TestView, unit: str) -> Markup:
        """Actuation of a test, "" of none; `unit` is its internal one."""
        if not self.systems[0].axes.actuated:
            return Markup()
        text = self.values([test.trace.reference_actuation], ACTUATION + unit, 4)
        return text + Markup(" (mean of a history)" if test.trace.varying else "")

    def sentence(self, sentence: Message | str) -> Markup:
        """A sentence with its quantities."""
        if isinstance(sentence, str):
            return self.words.sentence(sentence)
        texts = {
            name: self.values(value.values, value.unit, value.digits)
            if isinstance(value, Measure)
            else self.words.sentence(value)
            for name, value in sentence.values.items()
        }
        template = self.systems[0].text(sentence.template)
        return Markup(escape(template)).format(**texts)

    @property
    def table(self) -> Markup:
        """JSON for the script: factor and name of each unit in each system."""
        return Markup(script_json(self.conversions))


@dataclass(frozen=True)
class Addition:
    """What an application adds to a report: a value of its template, tables, and a figure.

    `tables` are CSV by their path from the run folder.
    """

    name: str
    value: Any
    tables: Mapping[str, str]
    figure: Any = None  # of matplotlib


def render(
    view: CampaignView,
    images: Mapping[str, bytes],
    sheet: Datasheet | None = None,
    additions: Sequence[Addition] = (),
) -> dict[str, str]:
    """HTML of the whole report, by the pages' paths from the run folder.

    `report.html` holds the pictures of all tests together; `tests/ID/page.html`, of each test,
    shows the PNGs beside it; `datasheet.html` is the data sheet alone, for printing.

    `images` are PNGs by the keys of `figures.draw_shared` and `draw_test`; of those of tests the
    first 24 bytes are enough. A picture that is not given is left out.
    """
    words = symbols.Symbols(view.model)

    def units() -> Units:
        return Units(view.systems, view.metric, words=words)

    added = {addition.name: addition.value for addition in additions}
    pages = {"report.html": _summary(view, images, sheet, units(), added)}
    if sheet is not None:
        values = _datasheet(sheet, view, words) | {"standard": added.get("standard")}
        pages["datasheet.html"] = render_page("datasheet.html.j2", units(), view=view, **values)
    judged = {judgement.subject: judgement for judgement in view.judgements}
    for test in view.tests:
        test_images = {
            key: png for key, png in images.items() if key.startswith(f"tests/{test.id}/")
        }
        pages[f"tests/{test.id}/page.html"] = render_page(
            "test.html.j2",
            units(),
            view=view,
            test=test,
            judged=judged.get(test.id),
            pictures={key: picture(key, png, embedded=False) for key, png in test_images.items()},
        )
    return pages


def _summary(
    view: CampaignView,
    images: Mapping[str, bytes],
    sheet: Datasheet | None,
    units: Units,
    added: Mapping[str, Any],
) -> str:
    held_out = [test for test in view.tests if test.role == "validate"]
    explained = [test.shares for test in held_out if test.shares]
    sources = dict.fromkeys(name for shares in explained for name in shares)
    shares = {n: sum(s.get(n, 0.0) for s in explained) / len(explained) for n in sources}
    explorer = explore(view) if view.tests else None
    parameters, laws = paper_sheets(view, units.words)
    custom_names = set(view.model.parameters) - view.model.standard_names if view.model else set()
    elsewhere = ELSEWHERE - custom_names
    columns = [test for test in view.tests if test.rows]
    left_out = None
    if view.left_out:
        left_out = score_sheet(
            [*view.left_out.rows, view.left_out.mean], "Scores, held out in turn"
        )
    terms = (term for subject in read_glossary().values() for term in subject.items())
    return render_page(
        "report.html.j2",
        units,
        *([explorer["library"]] if explorer else []),
        view=view,
        held_out=held_out,
        links={test.id: f"tests/{quote(test.id)}/page.html" for test in view.tests},
        pictures={
            key: picture(key, png) for key, png in images.items() if not key.startswith("tests/")
        },
        explorer=explorer,
        parameters=replace(
            parameters,
            heads=tuple(test.id for test in columns),
            rows=tuple(row for row in parameters.rows if row.name not in elsewhere),
        ),
        levels={test.id: units.level(test, view.actuation_unit) for test in columns},
        laws=laws,
        scores=score_sheet([test.score for test in held_out]),
        left_out=left_out,
        width=width_sentence(shares),
        exponents=[check for check in view.checks if check.check == FREE_EXPONENT],
        sensitivity=sensitivity_of(view, sheet),
        sentences=sentences,
        summaries=summaries,
        verdicts=list(Follows),
        advice=added.get("next"),
        standard=added.get("standard"),
        words={name: text for name, text in terms if name in WORDS},
        **_datasheet(sheet, view, units.words),
    )


def sensitivity_of(view: CampaignView, sheet: Datasheet | None) -> Rows:
    """What follows the prior: values for design, then constants of laws, then parameters."""
    of_tests = (row for test in view.tests for row in test.sensitivity)
    return (*(sheet.sensitivity if sheet is not None else ()), *view.sensitivity, *of_tests)


def _datasheet(
    sheet: Datasheet | None, view: CampaignView, words: symbols.Symbols
) -> dict[str, Any]:
    if sheet is None:
        return {"datasheet": None}
    properties = datasheet_sheet(sheet.rows, view.title, words, view.system.axes)
    noted = sheet.rows[sheet.rows["note"] != ""].drop_duplicates(["condition", "note"])
    return {
        "datasheet": sheet,
        "properties": properties.blocks(CONDITIONS),
        "property_notes": [f"{row.condition}: {row.note}" for row in noted.itertuples()],
    }


def render_page(template: str, units: Units, *scripts: str, **values: Any) -> str:
    """A page from its template; `scripts` are those that it may run besides the report's own."""
    script = files("mfd_bayes.reporting").joinpath("templates", "report.js").read_text("utf-8")
    compiled = environment().get_template(template)
    page = compiled.render(units=units, script=script, policy=policy_of(script, *scripts), **values)
    axes = units.systems[0].axes
    if axes == DAMPER:
        return page
    segments = _TEXT.split(page)  # what is between tags, but for scripts and styles
    return "".join(
        axes.text(segment) if index % 2 == 0 else segment for index, segment in enumerate(segments)
    )


_TEXT = re.compile(
    r"(<(?:script|style)\b.*?</(?:script|style)>|<(?:[^>\"']|\"[^\"]*\"|'[^']*')*>)", re.DOTALL
)


def policy_of(*scripts: str) -> str:
    """Content security policy that allows these scripts and pictures of the page, nothing else."""
    hashes = (base64.b64encode(hashlib.sha256(s.encode()).digest()).decode() for s in scripts)
    allowed = " ".join(f"'sha256-{digest}'" for digest in hashes) or "'none'"
    return (
        "default-src 'none'; img-src data: blob: file: 'self'; style-src 'unsafe-inline'; "
        f"script-src {allowed}; base-uri 'none'; form-action 'none'"
    )


@cache
def environment() -> Environment:
    """Environment of all templates, which are compiled once."""
    env = Environment(
        loader=PackageLoader("mfd_bayes.reporting"),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=_finalize,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    env.filters |= {
        "digits": symbols.number,
        "count": symbols.count,
        "percent": symbols.percent,
    }
    env.tests["finite"] = math.isfinite
    return env


def _finalize(value: object) -> object:
    """Value as a page shows it: without controls, which could hide or reverse text."""
    is_text = isinstance(value, str) and not isinstance(value, Markup)
    return symbols.printable(str(value)) if is_text else value


def read_glossary() -> dict[str, dict[str, Markup]]:
    """The words of the project with their meanings, as HTML, by subject."""
    text = files("mfd_bayes.reporting").joinpath("glossary.toml").read_text(encoding="utf-8")
    return {
        subject: {name: Markup(meaning) for name, meaning in terms.items()}
        for subject, terms in tomllib.loads(text).items()
    }


# --- the interactive plot of the loops, drawn by bokeh in the browser

FEWEST, MOST, ALL = 300, 1500, 250_000
"""Fewest and most samples of a test in the plot, and of all together, some 8 MB."""


def explore(view: CampaignView) -> dict[str, str]:
    """Interactive loop and history of the tests of a report, one test at a time.

    The parts are `library`, BokehJS; `item`, JSON of the plot without data; and `data`, JSON of the
    tests with little-endian float32 arrays in base64, in internal units.
    """
    from bokeh.embed import json_item
    from bokeh.resources import Resources

    library = "\n".join(Resources(mode="inline", components=["bokeh"], minified=True).js_raw)
    max_samples = max(FEWEST, min(MOST, ALL // max(1, len(view.tests))))
    data = {
        "systems": {
            s.name: {
                "length": "" if s.length == "1" else s.length,
                "force": s.force,
                "by": [s.factor("in"), s.factor("kip")],
                "names": [s.axes.name("displacement"), s.axes.name("force")],
                "labels": {
                    "x": s.label("displacement", "in"),
                    "t": "time, s" if s.axes.timed else "sample",
                    "y": s.label("force", "kip"),
                },
            }
            for s in view.systems
        },
        "tests": [_packed(test, view, max_samples) for test in view.tests],
    }
    # bokeh's numbers of models grow from call to call: here they begin at 1001
    numbers: dict[str, str] = {}
    item = re.sub(
        r'"p\d+"',
        lambda match: numbers.setdefault(match[0], f'"p{1001 + len(numbers)}"'),
        script_json(json_item(_layout())),
    )
    safe = library.replace("</", "<\\/").replace("<!--", "<\\!--")
    return {"library": safe, "item": item, "data": script_json(data)}


def script_json(value: object) -> str:
    """JSON that cannot close the script element around it."""
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c")


def _packed(test: TestView, view: CampaignView, max_samples: int) -> dict[str, Any]:
    """A test with evenly spaced samples, and all turning points unless they are too many."""
    trace, fan = test.trace, test.observation
    indices = np.linspace(0, trace.samples - 1, min(trace.samples, max_samples)).astype(np.intp)
    if trace.turning_points.size < max_samples // 4:
        indices = np.union1d(indices, trace.turning_points)
    widest = fan.widest
    missing = np.full(trace.samples, np.nan)
    arrays = {
        "time": trace.time,
        "displacement": trace.displacement,
        "force": missing if trace.force is None else trace.force,
        "median": fan.median,
        "lower": widest.lower,
        "upper": widest.upper,
    }
    stage = np.zeros(trace.samples) if test.stage is None else test.stage
    unit = view.actuation_unit
    return {
        "name": {s.name: f"{test.id}, {s.actuation(trace, unit)}" for s in view.systems},
        "fitted": test.role != "validate",
        "stage": "".join(str(int(code)) for code in stage[indices]),
    } | {
        name: base64.b64encode(values[indices].astype("<f4").tobytes()).decode("ascii")
        for name, values in arrays.items()
    }


def _layout() -> Any:
    """A loop and a history of one data source, which the page fills."""
    from bokeh.layouts import column
    from bokeh.models import ColumnDataSource

    names = ("x", "t", "force", "median", "lower", "upper", "stage")
    source = ColumnDataSource({name: [] for name in names}, name="samples")
    plots = [_plot(abscissa, height, source) for abscissa, height in (("x", 420), ("t", 260))]
    return column(*plots, sizing_mode="stretch_width", name="explorer")


def _plot(abscissa: str, height: int, source: Any) -> Any:
    """Force along the displacement "x" or the time "t", with a text at the pointer."""
    from bokeh.models import HoverTool, Range1d
    from bokeh.plotting import figure

    options: dict[str, Any] = {  # half of them are missing from bokeh's types
        "name": f"plot-{abscissa}",
        "height": height,
        "sizing_mode": "stretch_width",
        "tools": "pan,box_zoom,wheel_zoom,reset",
        "active_drag": "box_zoom",
        "x_range": Range1d(start=0, end=1),
        "y_range": Range1d(start=0, end=1),
        "toolbar_location": "above",
        "output_backend": "canvas",
    }
    plot = figure(**options)
    _, band, median = BANDS["observation"]
    # Along a loop the two edges go round the inside in opposite senses, so it stays empty; where
    # opposite branches overlap they cancel too, and the edges alone show the band.
    plot.varea(abscissa, "lower", "upper", source=source, fill_color=band, fill_alpha=0.7)
    for edge in ("lower", "upper") if abscissa == "x" else ():
        plot.line(abscissa, edge, source=source, color=SKY, line_width=0.5)
    plot.line(abscissa, "median", source=source, color=median, line_width=1.6)
    plot.line(abscissa, "force", source=source, color=DATA, line_width=1.2)
    dots = plot.scatter(abscissa, "force", source=source, size=7, alpha=0.0, line_alpha=0.0)
    dots.hover_glyph = None
    plot.add_tools(HoverTool(renderers=[dots], name=f"hover-{abscissa}", mode="mouse"))
    plot.toolbar.logo = None
    return plot


# --- the files of a report

ALL_DRAWN = 12
"""In a run of more tests, the pictures of single tests are drawn only where asked for."""

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome", "msedge")
"""Programs that can print a page, in order of preference."""

_PRINTING = 180.0
"""Longest time for printing, s; a report takes a few."""


def check_forms(options: ReportOptions, names: Sequence[str]) -> None:
    """Refuse what cannot be made of a run with these tests, before anything is written."""
    for name in options.tests:
        if name not in names:
            near = get_close_matches(name, names, 1)
            hint = f"did you mean {near[0]!r}?" if near else f"it has {', '.join(names)}"
            raise ReportError(f"--tests: the run has no test {name!r}; {hint}")
    if options.pdf:
        find_browser()
    for requested, library, extra in (
        (options.word, "docx", "word"),
        (options.excel, "openpyxl", "excel"),
    ):
        if requested and find_spec(library) is None:
            raise ReportError(
                f"this form needs {library}, which is not installed: pip install "
                f'"mfd_bayes[{extra}]"'
            )


def publish(
    view: CampaignView,
    options: ReportOptions,
    processes: int,
    observe: Callable[[Step], None],
    sheet: Datasheet | None = None,
    additions: Sequence[Addition] = (),
) -> None:
    """Write tables, figures and pages of a report into the run folder of its options."""
    folder = options.out
    system, symbols, frames = view.system, Symbols(view.model), report_frames(view)
    frames["sensitivity"] = frame_of("sensitivity", sensitivity_of(view, sheet))
    sheets = dict(zip(("parameters", "laws"), paper_sheets(view, symbols), strict=True))
    if sheet is not None:
        frames["datasheet"] = datasheet_frame(sheet.rows, system)
        frames["cycles"] = to_units(with_motion(sheet.cycles), system)
        sheets["datasheet"] = datasheet_sheet(sheet.rows, view.title, symbols, system.axes)
    for name, frame in frames.items():
        write_text(folder / f"{name}.csv", to_csv(frame))
    for name in ("parameters", "laws"):
        write_text(folder / f"{name}.json", to_json(view.title, name, frames[name]))
    for name, table in sheets.items():
        write_text(folder / f"{name}.tex", to_latex(name, table, symbols, system))
    if options.word:
        document = to_word(view.title, sheets.values(), symbols, system)
        write_bytes(folder / "tables.docx", document)
    if options.excel:
        write_bytes(folder / "tables.xlsx", to_excel({name: frames[name] for name in sheets}))
    observe(Step("report", "figures"))
    images = _draw(view, options, processes, additions)
    for name, text in shared_tables(view):
        write_text(folder / name, text)
    for addition in additions:
        for name, text in addition.tables.items():
            write_text(folder / name, text)
    observe(Step("report", "pages"))
    for name, page in render(view, images, sheet, additions).items():
        write_text(folder / name, page)
    if options.pdf:
        observe(Step("report", "PDF"))
        for name in ("report", *(["datasheet"] if sheet is not None else [])):
            write_bytes(folder / f"{name}.pdf", print_page(folder / f"{name}.html"))
    observe(Step("report", JobState.DONE))


def _draw(
    view: CampaignView,
    options: ReportOptions,
    processes: int,
    additions: Sequence[Addition],
) -> dict[str, bytes]:
    """Draw all figures; the bytes that the pages need, by the figures' keys.

    Those of a test stand beside its page, which needs only the size at the begin of each.
    """
    from mfd_bayes.reporting import figures

    folder, every = options.out, options.all_tests or len(view.tests) <= ALL_DRAWN
    tests = [test for test in view.tests if every or test.id in options.tests]
    for test in view.tests:  # what an earlier report has drawn may have nothing to show now
        for name in (*(f"{name}.png" for name in figures.OF_TEST), "record.csv"):
            (folder / "tests" / test.id / name).unlink(missing_ok=True)
    functions = [partial(draw_test, folder, replace(view, tests=()))] * len(tests)
    with several_processes(functions, processes) as evaluate:
        of_tests = list(evaluate(enumerate(tests)))
    shared = [
        *figures.draw_shared(view),
        *((addition.name, addition.figure) for addition in additions if addition.figure),
    ]
    images = {key: figures.to_png(figure) for key, figure in shared}
    for key, png in images.items():
        write_bytes(folder / "figures" / f"{key}.png", png)
    return images | {key: png for pictures in of_tests for key, png in pictures.items()}


def draw_test(folder: Path, view: CampaignView, test: TestView) -> dict[str, bytes]:
    """Write figures and table of a test; the first bytes of each figure, by its key."""
    from mfd_bayes.reporting import figures

    pictures = {}
    for key, figure in figures.draw_test(test, view):
        pictures[key] = figures.to_png(figure)
        write_bytes(folder / f"{key}.png", pictures[key])
    write_text(folder / "tests" / test.id / "record.csv", record_table(test, view.system))
    return {key: png[:24] for key, png in pictures.items()}


def find_browser() -> str:
    """Path of a browser that can print."""
    for name in BROWSERS:
        path = shutil.which(name)
        if path:
            return path
    raise ReportError(
        f"a PDF needs a Chromium, and none of {', '.join(BROWSERS)} is installed; "
        "print report.html from any browser instead"
    )


def print_page(page: Path) -> bytes:
    """PDF of a page, A4, printed by an installed Chromium."""
    browser = find_browser()
    with tempfile.TemporaryDirectory(prefix="mfd_bayes_pdf_") as folder:
        pdf = Path(folder) / "page.pdf"
        root = hasattr(os, "geteuid") and os.geteuid() == 0
        command = [
            *(browser, "--headless", "--disable-gpu", "--disable-quic", "--no-first-run"),
            *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
            *("--no-pdf-header-footer", f"--user-data-dir={folder}/profile"),
            *(["--no-sandbox"] if root else []),  # Chromium's own does not work for root
            *(f"--print-to-pdf={pdf}", page.resolve().as_uri()),
        ]
        try:
            process = subprocess.run(command, capture_output=True, timeout=_PRINTING, check=False)
        except (OSError, subprocess.TimeoutExpired) as error:
            raise ReportError(f"{browser} did not print {page}: {error}") from error
        if process.returncode != 0 or not pdf.is_file() or pdf.stat().st_size == 0:
            lines = process.stderr.decode("utf-8", "replace").strip().splitlines()
            reason = lines[-1] if lines else "no reason"
            raise ReportError(f"{browser} did not print {page}: {reason}")
        return pdf.read_bytes()
