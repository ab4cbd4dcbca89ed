"""What makes a band wide, in words."""

from __future__ import annotations

from collections.abc import Mapping

from mfd_bayes.population.bands import ADVICE

_TENTHS = (
    *("less than a tenth", "a tenth", "two tenths", "three tenths", "four tenths", "half"),
    *("six tenths", "seven tenths", "eight tenths", "nine tenths", "nearly all"),
)


def width_sentence(shares: Mapping[str, float]) -> str:
    """Which source makes a band wide, and what can be done about it; "" without shares."""
    if not shares:
        return ""
    name = max(shares, key=lambda source: shares[source])
    tenths = min(max(round(10 * shares[name]), 1), 10)
    verb = "comes" if tenths in (1, 5, 10) else "come"
    text = f"{_TENTHS[tenths].capitalize()} of the band's variance {verb} from {_article(name)}."
    return f"{text} {ADVICE[name]}"


def _article(name: str) -> str:
    return name if name in ("noise",) or name.startswith("test-to-test") else f"the {name}"
