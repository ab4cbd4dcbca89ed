"""What tests at zero actuation do not tell, in sentences."""

from __future__ import annotations

from collections.abc import Iterable

from mfd_bayes.population.design import Design


def zero_sentences(design: Design, tests: Iterable[str]) -> list[str]:
    """Sentences about tests at zero actuation: what informs no law, and why.

    Parameters
    ----------
    design : Design
    tests : iterable of str
        Ids of the calibrated tests, in the design's order.
    """
    named = list(zip(tests, design.settings, strict=False))
    zeros = ", ".join(name for name, setting in named if setting.actuation == 0)
    out = [n for n, told in zip(design.names, design.informs.T, strict=True) if not told.all()]
    if not zeros or not out:
        return []
    laws = ", ".join(f"{name} ({design.laws[name]})" for name in out)
    return [
        f"A law without an intercept has no value at zero actuation: from {zeros} nothing is "
        f"learned about {laws}. The laws affine and residual_power would learn from it."
    ]
