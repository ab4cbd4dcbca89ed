"""The order of tests that follow each other without a reset, checked."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from mfd_bayes.errors import CampaignError
from mfd_bayes.records.record import Window


@dataclass(frozen=True)
class Part:
    """The part of a file that a test is: all of it where there is no window, s."""

    file: Path
    window: Window | None = None


def check_parts(path: Path, after: Mapping[str, str], parts: Mapping[str, Part]) -> None:
    """Refuse a test that follows one of the same file, of which it is no later part.

    Raises
    ------
    CampaignError
        When a window is missing, or begins before the other ends.
    """
    for name, before in after.items():
        if not before or parts[name].file != parts[before].file:
            continue
        own, other = parts[name].window, parts[before].window
        if own is None or other is None or own[0] < other[1]:
            raise CampaignError(
                f"after of test {name!r} in {path} is a test of the same file, {before!r}: the "
                "fit window of the one must begin where that of the other ends, or later, got "
                f"{_words(own)} after {_words(other)}"
            )


def _words(window: Window | None) -> str:
    return "all of the file" if window is None else f"{window[0]:g} s to {window[1]:g} s"


def check_order(path: Path, after: Mapping[str, str]) -> None:
    """Refuse an order in which no tests can have been made.

    Parameters
    ----------
    path : Path
        Campaign file, named in the error message.
    after : mapping of str to str
        Id of every test to that of the one that it follows; "" where it follows none.

    Raises
    ------
    CampaignError
        When a test follows one that is not there, or itself, also by way of others, or two tests
        follow the same one.
    """
    followers: dict[str, str] = {}
    for name, before in after.items():
        if not before:
            continue
        where = f"after of test {name!r} in {path}"
        if before not in after:
            raise CampaignError(
                f"{where} must be the id of another test, got {before!r}{_near(after, before)}"
            )
        if before == name:
            raise CampaignError(f"{where} must be the id of another test, got its own")
        other = followers.setdefault(before, name)
        if other != name:
            raise CampaignError(
                f"{where} must be a test that no other follows directly, got {before!r}, which "
                f"test {other!r} follows"
            )
    left = set(followers)  # once every chain is followed back from its end: those of circles
    for last in (name for name in after if name not in followers):
        while last:
            left.discard(last)
            last = after[last]
    for name in (name for name in after if name in left):
        raise CampaignError(
            f"after of test {name!r} in {path} must lead back to a test that follows none, got a "
            f"circle: {_circle(after, name)}"
        )


def _near(after: Mapping[str, str], before: str) -> str:
    """Hint at the nearest id."""
    near = difflib.get_close_matches(before, after, n=1)
    return f"; did you mean {near[0]!r}?" if near else ""


def _circle(after: Mapping[str, str], name: str) -> str:
    """Tests of a circle, in words."""
    chain = [name]
    while after[chain[-1]] != name:
        chain.append(after[chain[-1]])
    return " after ".join([*chain, name])
