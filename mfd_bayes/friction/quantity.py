"""A quantity of a test that has a prior or a posterior: what it measures and how it is written."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mfd_bayes.units import DIMENSIONS


@dataclass(frozen=True)
class Quantity:
    """One quantity of a model, of a noise or of the record.

    Attributes
    ----------
    name : str
        In prior files, tables and stored draws.
    kind : str
        What it measures, a key of `units.DIMENSIONS`.
    maths, html : str
        Its symbol in LaTeX's mathematics and in HTML.
    meaning : str
        What it is, in a few words.
    least, most : float, internal units
        Values that it can have; a prior must not allow others.
    sampled : bool
        Whether it has a prior of its own; if not, it is computed from others that have.
    pooled : bool
        Whether one test tells something about its value in another.
    """

    name: str
    kind: str
    maths: str
    html: str
    meaning: str
    least: float = 0.0
    most: float = np.inf
    sampled: bool = True
    pooled: bool = True

    @property
    def unit(self) -> str:
        """Internal unit."""
        return DIMENSIONS[self.kind].unit
