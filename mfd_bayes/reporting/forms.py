"""Forms of a report that are made only where they are asked for."""

from __future__ import annotations

from dataclasses import dataclass

from mfd_bayes.reporting.paper_tables import check_library
from mfd_bayes.reporting.pdf import find_browser


@dataclass(frozen=True)
class Forms:
    """Parts of a report that are made only where asked for: they need more software or time."""

    pdf: bool = False
    word: bool = False
    excel: bool = False
    next_test: bool = False

    def check(self) -> None:
        """Refuse a form that cannot be made, before anything is written.

        Raises
        ------
        ReportError
            When a library, or for a PDF a browser, is not there.
        """
        if self.pdf:
            find_browser()
        if self.word:
            check_library("docx", "word")
        if self.excel:
            check_library("openpyxl", "excel")


PLAIN = Forms()
