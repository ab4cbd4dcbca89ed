"""Forms of a report that are made only where they are asked for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from difflib import get_close_matches

from mfd_bayes.errors import ReportError
from mfd_bayes.reporting.paper_tables import check_library
from mfd_bayes.reporting.pdf import find_browser

ONE_PAGE = 12
"""A report of more tests has a page for each, whose pictures are drawn only where asked for."""


@dataclass(frozen=True)
class Forms:
    """Parts of a report that are made only where asked for: they need more software or time.

    Attributes
    ----------
    pdf, word, excel, next_test : bool
        A PDF of the page, the tables for Word and Excel, the section on the next test.
    tests : tuple of str
        Tests whose pictures are drawn, where there are more than `ONE_PAGE`.
    all_tests : bool
        Whether those of all tests are.
    """

    pdf: bool = False
    word: bool = False
    excel: bool = False
    next_test: bool = False
    tests: tuple[str, ...] = ()
    all_tests: bool = False

    def drawn(self, names: Sequence[str]) -> tuple[str, ...]:
        """Those of a report's tests whose pictures are drawn."""
        if self.all_tests or len(names) <= ONE_PAGE:
            return tuple(names)
        return tuple(name for name in names if name in self.tests)

    def check(self, names: Sequence[str]) -> None:
        """Refuse what cannot be made of a run with these tests, before anything is written.

        Raises
        ------
        ReportError
            When a library, or for a PDF a browser, is not there, or the run has no such test.
        """
        for name in self.tests:
            if name not in names:
                near = get_close_matches(name, names, 1)
                hint = f"did you mean {near[0]!r}?" if near else f"it has {', '.join(names)}"
                raise ReportError(f"--tests: the run has no test {name!r}; {hint}")
        if self.pdf:
            find_browser()
        if self.word:
            check_library("docx", "word")
        if self.excel:
            check_library("openpyxl", "excel")


PLAIN = Forms()
