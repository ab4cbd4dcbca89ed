"""What makes a band wide, in words."""

from __future__ import annotations

from collections.abc import Mapping

from mfd_bayes.population.bands import ADVICE


def width_sentence(shares: Mapping[str, float]) -> str:
    """Which source makes a band wide, and what can be done about it; "" without shares."""
    if not shares:
        return ""
    name = max(shares, key=lambda source: shares[source])
    article = "" if name == "noise" or name.startswith("test-to-test") else "the "
    return f"{100 * shares[name]:.0f} % of the variance is from {article}{name}. {ADVICE[name]}"
