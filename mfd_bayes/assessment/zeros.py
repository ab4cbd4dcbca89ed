"""What tests at zero actuation do not tell, in sentences."""

from __future__ import annotations

from collections.abc import Iterable

from mfd_bayes.population.layout import Layout


def zero_sentences(layout: Layout, tests: Iterable[str]) -> list[str]:
    """Sentences about tests at zero actuation: what informs no law, and why.

    Parameters
    ----------
    layout : Layout
    tests : iterable of str
        Ids of the calibrated tests, in the layout's order.
    """
    named = list(zip(tests, layout.settings, strict=False))
    zeros = ", ".join(name for name, setting in named if setting.actuation == 0)
    out = [n for n, told in zip(layout.names, layout.informs.T, strict=True) if not told.all()]
    if not zeros or not out:
        return []
    laws = ", ".join(f"{name} ({layout.laws[name]})" for name in out)
    return [
        f"A law without an intercept has no value at zero actuation: from {zeros} nothing is "
        f"learned about {laws}. The laws affine and residual_power would learn from it."
    ]
