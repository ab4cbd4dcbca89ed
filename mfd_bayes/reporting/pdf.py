"""The report as a PDF, printed by an installed Chromium."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

from mfd_bayes.errors import ReportError

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome", "msedge")
"""Programs that can print a page, in order of preference."""

SECONDS = 180.0
"""Longest time for printing; a report takes a few seconds."""


def find_browser() -> str:
    """Path of a browser that can print.

    Raises
    ------
    ReportError
        When none is installed.
    """
    for name in BROWSERS:
        found = shutil.which(name)
        if found:
            return found
    raise ReportError(
        f"a PDF needs a Chromium, and none of {', '.join(BROWSERS)} is installed; "
        "print report.html from any browser instead"
    )


def print_page(page: Path) -> bytes:
    """PDF of a page, A4.

    Raises
    ------
    ReportError
        When no browser is installed, or it does not print.
    """
    browser = find_browser()
    with tempfile.TemporaryDirectory(prefix="mfd_bayes_pdf_") as folder:
        made = Path(folder) / "page.pdf"
        command = [
            *(browser, "--headless", "--disable-gpu", "--disable-quic", "--no-first-run"),
            *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
            *("--no-pdf-header-footer", f"--user-data-dir={folder}/profile"),
            *(["--no-sandbox"] if _is_root() else []),  # Chromium's own does not work for root
            *(f"--print-to-pdf={made}", page.resolve().as_uri()),
        ]
        try:
            done = subprocess.run(command, capture_output=True, timeout=SECONDS, check=False)
        except (OSError, subprocess.TimeoutExpired) as error:
            raise ReportError(f"{browser} did not print {page}: {error}") from error
        if done.returncode != 0 or not made.is_file() or made.stat().st_size == 0:
            said = done.stderr.decode("utf-8", "replace").strip().splitlines()
            raise ReportError(
                f"{browser} did not print {page}: {said[-1] if said else 'no reason'}"
            )
        return made.read_bytes()


def _is_root() -> bool:
    return hasattr(os, "geteuid") and os.geteuid() == 0
