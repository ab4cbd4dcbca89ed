"""The report as HTML pages that load nothing from the network."""

from __future__ import annotations

import base64
import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, partial
from importlib.resources import files
from typing import Any, BinaryIO
from urllib.parse import quote

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined, Template
from markupsafe import Markup, escape

from mfd_bayes.calibration.identifiability import SENSITIVE, TRADE_OFF
from mfd_bayes.evaluation.checks import INFORMED
from mfd_bayes.evaluation.next_test import advice_sentence, shown_rows, together_words
from mfd_bayes.evaluation.views import FREE_EXPONENT, CampaignView, TestView
from mfd_bayes.evaluation.width import width_sentence
from mfd_bayes.reporting import symbols
from mfd_bayes.reporting.conversion import shown_in
from mfd_bayes.reporting.digest import (
    convergence_of,
    derived_of,
    grid_of,
    is_judged,
    is_of_fit,
    is_of_sampler,
    is_weak,
    mean_shares,
    uninformed_of,
    verdicts_of,
)
from mfd_bayes.reporting.explorer import explore
from mfd_bayes.reporting.figure_data import table_of
from mfd_bayes.reporting.forms import ONE_PAGE
from mfd_bayes.reporting.glossary import read_glossary
from mfd_bayes.runs.unit_system import System

Pair = tuple[System, System]
"""Customary and metric system of units."""

NEXT = 10
"""Candidates for the next test that the page shows."""

_HEAD = 24
"""Bytes of a PNG up to the end of its size."""


@dataclass(frozen=True)
class Picture:
    """A PNG as a page shows it; width and height in pixels.

    `uri` is the embedded PNG, or its path. `png` and `csv` are the paths from the page to the
    picture and to the table behind it.
    """

    uri: str
    width: int
    height: int
    png: str
    csv: str


def render(view: CampaignView, images: Mapping[str, bytes]) -> dict[str, str]:
    """HTML of the whole report, by the pages' paths from the run folder.

    A report of up to `ONE_PAGE` tests is one page with all pictures embedded. With more tests,
    the first page has the pictures of all tests together, and each test has a page of its own
    that shows the PNGs beside it.

    Parameters
    ----------
    view : CampaignView
    images : mapping of str to bytes
        PNGs by the keys of `figures.draw_shared` and `draw_test`, as far as they are `needed`;
        a picture that is not given is left out.
    """
    whole = len(view.tests) <= ONE_PAGE
    environment, shared = page_environment(view.systems), _shared(view)
    explorer = explore(view) if view.tests else None
    shown = {key: png for key, png in images.items() if whole or not key.startswith("tests/")}
    pages = {
        "report.html": environment.get_template("report.html.j2").render(
            **shared,
            whole=whole,
            pictures={key: _picture(key, png, embedded=True) for key, png in shown.items()},
            links=_links(view, whole),
            explorer=explorer,
            policy=policy_of(shared["script"], *([explorer.library] if explorer else [])),
            glossary=read_glossary(),
        )
    }
    if whole:
        return pages
    template = environment.get_template("test.html.j2")
    page_of = partial(_test_page, template, shared, images)
    return pages | {f"tests/{test.id}/report.html": page_of(test) for test in view.tests}


def _test_page(
    template: Template, shared: Mapping[str, Any], images: Mapping[str, bytes], test: TestView
) -> str:
    """Page of one test, which shows the PNGs beside it."""
    own = {key: png for key, png in images.items() if key.startswith(f"tests/{test.id}/")}
    return template.render(
        view=shared["view"],
        test=test,
        pictures={key: _picture(key, png, embedded=False) for key, png in own.items()},
        cells=shared["cells"],
        verdicts=shared["verdicts"],
        script=shared["script"],
        policy=policy_of(shared["script"]),
        fit=grid_of(check for check in test.checks if is_of_fit(check)),
        sampler=grid_of(check for check in test.checks if is_of_sampler(check)),
    )


def needed(view: CampaignView, key: str, png: BinaryIO) -> bytes:
    """Bytes of a PNG that its page needs: all, or those up to its size if it is not embedded."""
    beside = len(view.tests) > ONE_PAGE and key.startswith("tests/")
    return png.read(_HEAD if beside else -1)


def _shared(view: CampaignView) -> dict[str, Any]:
    """Values that the templates of all pages use."""
    shares = mean_shares(view)
    return {
        "view": view,
        "sources": list(shares),
        "width": width_sentence(shares),
        "next": _next(view),
        "calibrated": [test for test in view.tests if test.role != "validate"],
        "held_out": [test for test in view.tests if test.role == "validate"],
        "names": list(dict.fromkeys(row.name for test in view.tests for row in test.rows)),
        "units_of": {row.name: row.unit for test in view.tests for row in test.rows},
        "derived": derived_of(view),
        "cells": {(row.subject, row.name): row for test in view.tests for row in test.rows},
        "readings": {(r.subject, r.name): r for test in view.tests for r in test.readings},
        "convergence": convergence_of(view),
        "judged": [check for check in view.checks if is_judged(check)],
        "fit": grid_of(check for check in view.checks if is_of_fit(check)),
        "exponents": [check for check in view.checks if check.name == FREE_EXPONENT],
        "sampler": grid_of(check for check in view.checks if is_of_sampler(check)),
        "uninformed": uninformed_of(view),
        "verdicts": verdicts_of(view),
        "limit": INFORMED,
        "trade_off": TRADE_OFF,
        "sensitive": SENSITIVE,
        "script": _script("report.js"),
    }


def _next(view: CampaignView) -> dict[str, Any] | None:
    """Sentences and rows on the next test, where it was asked for."""
    if view.next_test is None:
        return None
    units = shown_in(view), view.actuation_unit
    return {
        "sentences": [
            advice_sentence(view.next_test, *units),
            *together_words(view.next_test, *units),
        ],
        "rows": shown_rows(view.next_test, *units, NEXT),
    }


def _links(view: CampaignView, whole: bool) -> dict[str, str]:
    """Link from the first page to each test."""
    if whole:
        return {test.id: f"#test-{at}" for at, test in enumerate(view.tests, start=1)}
    return {test.id: f"tests/{quote(test.id)}/report.html" for test in view.tests}


def _script(name: str) -> str:
    return files("mfd_bayes.reporting").joinpath("templates", name).read_text(encoding="utf-8")


def policy_of(*scripts: str) -> str:
    """Content security policy that allows these scripts and pictures of the page, nothing else."""
    hashes = (base64.b64encode(hashlib.sha256(s.encode()).digest()).decode() for s in scripts)
    allowed = " ".join(f"'sha256-{digest}'" for digest in hashes) or "'none'"
    return (
        "default-src 'none'; img-src data: blob: file: 'self'; style-src 'unsafe-inline'; "
        f"script-src {allowed}; base-uri 'none'; form-action 'none'"
    )


@cache
def page_environment(systems: Pair) -> Environment:
    """Environment of the templates of all pages; to compile them takes most of a page."""
    environment = Environment(
        loader=PackageLoader("mfd_bayes.reporting"),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=_finalize,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {
        "number": symbols.number,
        "count": symbols.count,
        "percent": symbols.percent,
        "symbol": symbols.in_html,
        "meaning": symbols.meaning,
        "unit": symbols.unit_text,
        "both": partial(_both, systems),
        "units": partial(_both_units, systems),
        "actuation": partial(_both_actuations, systems),
        "peak_of": lambda test, signal: float(np.max(np.abs(getattr(test.trace, signal)))),
        "duration": lambda test: float(test.trace.time[-1] - test.trace.time[0]),
    }
    environment.tests["weak"] = is_weak
    environment.tests["known"] = math.isfinite
    return environment


def _finalize(value: object) -> object:
    """Value as a page shows it: without controls, which could hide or reverse text."""
    is_text = isinstance(value, str) and not isinstance(value, Markup)
    return symbols.printable(str(value)) if is_text else value


def _picture(key: str, png: bytes, *, embedded: bool) -> Picture:
    """Picture for a page; its size is in the first chunk of the PNG."""
    width, height = (int.from_bytes(png[at : at + 4], "big") for at in (16, 20))
    path = f"{key}.png" if key.startswith("tests/") else f"figures/{key}.png"
    table = table_of(key)
    if embedded:
        uri = f"data:image/png;base64,{base64.b64encode(png).decode('ascii')}"
        return Picture(uri, width, height, quote(path), quote(table))
    name = quote(path.rpartition("/")[2])
    return Picture(name, width, height, name, quote(table.rpartition("/")[2]))


def embedded_picture(key: str, png: bytes) -> Picture:
    """Picture that is part of its page."""
    return _picture(key, png, embedded=True)


def _both(systems: Pair, value: float, unit: str, digits: int = 4) -> Markup:
    """A number in both systems of units; the page shows the one that the reader chose."""
    if not math.isfinite(value) or systems[1].unit(unit) == unit:
        return escape(symbols.number(value, digits))
    return either(*(symbols.number(value * s.factor(unit), digits) for s in systems))


def _both_units(systems: Pair, unit: str) -> Markup:
    """A unit in both systems."""
    if systems[1].unit(unit) == unit:
        return escape(symbols.unit_text(unit))
    return either(*(symbols.unit_text(s.unit(unit)) for s in systems))


def _both_actuations(systems: Pair, test: TestView, unit: str) -> Markup:
    """A test's actuation in both systems."""
    return either(*(s.actuation(test.trace, unit) for s in systems))


def either(us: str, si: str) -> Markup:
    """Two texts, of which the page shows that in the system that the reader chose."""
    return Markup('<span class="us">{}</span><span class="si">{}</span>').format(us, si)
