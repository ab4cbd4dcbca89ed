"""The report as pages without network."""

from __future__ import annotations

import base64
import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from typing import Any, BinaryIO
from urllib.parse import quote

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from mfd_bayes.assessment.systems import SI, SYSTEMS
from mfd_bayes.assessment.views import STANDING, CampaignView, TestView
from mfd_bayes.calibration.identifiability import SENSITIVE, TRADE_OFF
from mfd_bayes.reporting import symbols
from mfd_bayes.reporting.digest import (
    UNINFORMED,
    convergence_of,
    derived_of,
    grid_of,
    is_judged,
    is_of_fit,
    is_of_sampler,
    is_weak,
    uninformed_of,
    verdicts_of,
)
from mfd_bayes.reporting.explorer import explore
from mfd_bayes.reporting.figure_data import table_of

ONE_PAGE = 12
"""A report of more tests has a page for each."""

_HEAD = 24
"""Bytes of a PNG up to the end of its size."""


@dataclass(frozen=True)
class Picture:
    """A PNG as a page shows it, embedded or beside it; width and height in pixels.

    `png` and `csv` are where the picture and the table behind it lie, seen from the page.
    """

    uri: str
    width: int
    height: int
    png: str
    csv: str


def render(view: CampaignView, images: Mapping[str, bytes]) -> dict[str, str]:
    """HTML of the whole report, by the pages' paths from the run folder.

    A report of few tests is one page, complete in itself. Beyond `ONE_PAGE` tests the first
    page, complete in itself too, is an index, and every test has a page of its own that shows
    the PNGs beside it.

    Parameters
    ----------
    view : CampaignView
    images : mapping of str to bytes
        PNGs by the keys of `figures.draw_shared` and `draw_test`, as far as they are `needed`;
        a picture that is not given is left out.
    """
    whole = len(view.tests) <= ONE_PAGE
    shown = {key: png for key, png in images.items() if whole or not key.startswith("tests/")}
    shared = _shared(view)
    explorer = explore(view) if view.tests else None
    script = _script("report.js")
    pages = {
        "report.html": _environment()
        .get_template("report.html.j2")
        .render(
            **shared,
            whole=whole,
            pictures={key: _picture(key, png, embedded=True) for key, png in shown.items()},
            links=_links(view, whole),
            explorer=explorer,
            script=script,
            policy=_policy(script, *([explorer.library] if explorer else [])),
        )
    }
    if not whole:
        template = _environment().get_template("test.html.j2")
        for test in view.tests:
            home = f"tests/{test.id}/"
            pictures = {
                key: _picture(key, png, embedded=False)
                for key, png in images.items()
                if key.startswith(home)
            }
            pages[f"{home}report.html"] = template.render(
                view=view,
                test=test,
                pictures=pictures,
                cells=shared["cells"],
                verdicts=shared["verdicts"],
                script=script,
                policy=_policy(script),
                fit=grid_of(c for c in test.checks if is_of_fit(c)),
                sampler=grid_of(c for c in test.checks if is_of_sampler(c)),
            )
    return pages


def needed(view: CampaignView, key: str, png: BinaryIO) -> bytes:
    """What of a PNG its page needs: all of it, or its head where it lies beside the page."""
    beside = len(view.tests) > ONE_PAGE and key.startswith("tests/")
    return png.read(_HEAD if beside else -1)


def _shared(view: CampaignView) -> dict[str, Any]:
    """What every page of a report may show."""
    return {
        "view": view,
        "calibrated": [test for test in view.tests if test.role != "validate"],
        "held_out": [test for test in view.tests if test.role == "validate"],
        "names": list(dict.fromkeys(row.name for test in view.tests for row in test.rows)),
        "units_of": {row.name: row.unit for test in view.tests for row in test.rows},
        "derived": derived_of(view),
        "cells": {(row.subject, row.name): row for test in view.tests for row in test.rows},
        "convergence": convergence_of(view),
        "judged": [check for check in view.checks if is_judged(check)],
        "fit": grid_of(check for check in view.checks if is_of_fit(check)),
        "standing": [check for check in view.checks if check.name == STANDING],
        "sampler": grid_of(check for check in view.checks if is_of_sampler(check)),
        "uninformed": uninformed_of(view),
        "verdicts": verdicts_of(view),
        "limit": UNINFORMED,
        "trade_off": TRADE_OFF,
        "sensitive": SENSITIVE,
    }


def _links(view: CampaignView, whole: bool) -> dict[str, str]:
    """Where each test is shown, seen from the first page."""
    if whole:
        return {test.id: f"#test-{at}" for at, test in enumerate(view.tests, start=1)}
    return {test.id: f"tests/{quote(test.id)}/report.html" for test in view.tests}


def _script(name: str) -> str:
    return files("mfd_bayes.reporting").joinpath("templates", name).read_text(encoding="utf-8")


def _policy(*scripts: str) -> str:
    """Content security policy: these scripts and embedded pictures, nothing from elsewhere."""
    hashes = (base64.b64encode(hashlib.sha256(s.encode()).digest()).decode() for s in scripts)
    allowed = " ".join(f"'sha256-{digest}'" for digest in hashes)
    return (
        "default-src 'none'; img-src data: blob: file: 'self'; style-src 'unsafe-inline'; "
        f"script-src {allowed}; base-uri 'none'; form-action 'none'"
    )


def _environment() -> Environment:
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
        "both": _both,
        "units": _both_units,
        "actuation": _both_actuations,
        "peak_of": lambda test, signal: float(np.max(np.abs(getattr(test.trace, signal)))),
        "duration": lambda test: float(test.trace.time[-1] - test.trace.time[0]),
    }
    environment.tests["weak"] = is_weak
    environment.tests["known"] = math.isfinite
    return environment


def _finalize(value: object) -> object:
    """Value as a page may show it: what is no character turns no text around and hides nothing."""
    is_text = isinstance(value, str) and not isinstance(value, Markup)
    return symbols.printable(str(value)) if is_text else value


def _picture(key: str, png: bytes, *, embedded: bool) -> Picture:
    """Picture for a page; its size stands in the PNG's first chunk."""
    width, height = (int.from_bytes(png[at : at + 4], "big") for at in (16, 20))
    path = f"{key}.png" if key.startswith("tests/") else f"figures/{key}.png"
    table = table_of(key)
    if embedded:
        uri = f"data:image/png;base64,{base64.b64encode(png).decode('ascii')}"
        return Picture(uri, width, height, quote(path), quote(table))
    name = quote(path.rpartition("/")[2])
    return Picture(name, width, height, name, quote(table.rpartition("/")[2]))


def _both(value: float, unit: str, digits: int = 4) -> Markup:
    """A number in both systems; the page shows the one that is chosen."""
    if not math.isfinite(value) or SI.factor(unit) == 1.0:
        return escape(symbols.number(value, digits))
    return _either(*(symbols.number(value * s.factor(unit), digits) for s in SYSTEMS))


def _both_units(unit: str) -> Markup:
    """A unit in both systems."""
    if SI.unit(unit) == unit:
        return escape(symbols.unit_text(unit))
    return _either(*(symbols.unit_text(s.unit(unit)) for s in SYSTEMS))


def _both_actuations(test: TestView, unit: str) -> Markup:
    """A test's actuation in both systems."""
    return _either(*(s.actuation(test.trace, unit) for s in SYSTEMS))


def _either(us: str, si: str) -> Markup:
    return Markup('<span class="us">{}</span><span class="si">{}</span>').format(us, si)
