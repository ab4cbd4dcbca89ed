"""The table of the faults that were tried."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

KINDS = {
    "equivalent": "Change nothing that the code promises:",
    "tuning": "Change how finely, fast or evenly something works, not the answer:",
    "words": "Change only words:",
    "tolerable": "Change something small that no test should pin down:",
    "hole": "Tests should notice and do not:",
    "unknown": "Not looked at:",
}
"""What a fault that survived may be; the first two are no holes in the tests."""

STATES = ("killed", "timed out", "survived")


@dataclass(frozen=True)
class Outcome:
    """What became of a fault.

    Attributes
    ----------
    module : str
    line, column : int
    function : str
    text : str
        Of the line.
    change : str
    state : str
        One of `STATES`, or "slow" where only a slow test noticed it.
    test : str
        The first that failed, or why there is none.
    seconds : float
    """

    module: str
    line: int
    column: int
    function: str
    text: str
    change: str
    state: str = "survived"
    test: str = ""
    seconds: float = 0.0

    @property
    def key(self) -> tuple[str, str, int, str]:
        """What stays the same when lines are added above."""
        return self.module, self.text, self.column, self.change


Judged = dict[tuple[str, str], list[tuple[str, str, str]]]
"""Start of the line's text, kind and reason of what was looked at, by module and change."""


def judgements(path: Path) -> Judged:
    """What faults that were looked at are."""
    found: Judged = {}
    for group in tomllib.loads(path.read_text(encoding="utf-8")).get("survived", []):
        assert group["kind"] in KINDS, group
        for start, change in group["faults"]:
            told = (start, group["kind"], group["why"])
            found.setdefault((group["module"], change), []).append(told)
    return found


def _judged(outcome: Outcome, judged: Judged) -> tuple[str, str]:
    for start, kind, why in judged.get((outcome.module, outcome.change), ()):
        if outcome.text.startswith(start):
            return kind, why
    return "unknown", outcome.test


def table(counts: Mapping[str, int], done: Sequence[Outcome], judged: Judged) -> str:
    """Counts for each module, shares, and the faults that survived, grouped by kind."""
    return "\n".join(
        [*_modules(counts, done), "", *_shares(done, judged), *_survivors(done, judged)]
    )


def listed(done: Sequence[Outcome], judged: Judged, *, with_slow: bool) -> str:
    """How many faults fast and slow tests noticed, each fault, and what the survivors are."""
    fast = sum(o.state in ("killed", "timed out") for o in done)
    slow = sum(o.state == "slow" for o in done)
    lines = [
        f"{fast} of {len(done)} faults were noticed by fast tests, {slow} by slow tests only:",
        f"the fast tests noticed {100 * fast / max(fast + slow, 1):.0f} % of what was noticed."
        if with_slow
        else "the slow tests were not tried on the others.",
        *_shares(done, judged),
        "",
    ]
    for o in done:
        lines += [f"{o.module[10:]}:{o.line} {_short(o.change)}", f"    {o.state} {_short(o.test)}"]
    return "\n".join([*lines, *_survivors(done, judged)])


def _modules(counts: Mapping[str, int], done: Sequence[Outcome]) -> list[str]:
    width = max(map(len, counts))
    head = "".join(f"{word:>10}" for word in ("faults", "tried", *STATES, "share"))
    lines = [f"{'':{width}}{head}"]
    rows = [(module, [o for o in done if o.module == module]) for module in counts]
    for name, mine in [*rows, ("all", list(done))]:
        number = [sum(o.state == state for o in mine) for state in STATES]
        faults = counts.get(name, sum(counts.values()))
        share = f"{100 * (1 - number[2] / len(mine)):.0f} %" if mine else "-"
        cells = "".join(f"{n:>10}" for n in (faults, len(mine), *number, share))
        lines.append(f"{name:{width}}{cells}")
    return lines


def _shares(done: Sequence[Outcome], judged: Judged) -> list[str]:
    lost = [o for o in done if o.state == "survived"]
    kinds = [_judged(o, judged)[0] for o in lost]
    noticed = len(done) - len(lost)
    meant = len(done) - sum(kind in ("equivalent", "tuning") for kind in kinds)
    return [
        f"{100 * noticed / len(done):.1f} % of {len(done)} faults were noticed;",
        f"{100 * noticed / meant:.1f} % of the {meant} that are neither equivalent nor tuning.",
    ]


def _survivors(done: Sequence[Outcome], judged: Judged) -> list[str]:
    lines = []
    for kind, title in KINDS.items():
        reasons: dict[str, list[Outcome]] = {}
        for o in done:
            found, why = _judged(o, judged)
            if o.state == "survived" and found == kind:
                reasons.setdefault(why, []).append(o)
        if reasons:
            lines += ["", f"{title} {sum(map(len, reasons.values()))}"]
        for why, those in reasons.items():
            lines += [f"  {why or 'nothing is known'}"]
            lines += [f"    {o.module[10:]}:{o.line} {_short(o.text)} | {o.change}" for o in those]
    return lines


def _short(text: str) -> str:
    return text if len(text) <= 60 else f"{text[:58]} …"
