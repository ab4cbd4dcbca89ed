"""How well a law, or what a quantity follows, predicted what was left out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mfd_bayes.store.files import Figure

LARGEST_K = 0.7  # Pareto k above which a score cannot be trusted, and its law is not weighed


@dataclass(frozen=True)
class LawScore:
    """Score of one law for one quantity."""

    quantity: str
    law: str
    elpd: Figure  # sum of log predictive densities of levels given the others, in prior units
    se: Figure  # standard error of the sum, from the spread of its terms
    weight: Figure  # stacking weight among the laws; 0 where its score cannot be trusted
    levels: tuple[Figure, ...]  # the terms of the sum
    pareto_k: Figure = np.nan  # of the importance weights

    @property
    def trusted(self) -> bool:
        """Whether its Pareto k allows to weigh it."""
        return not self.pareto_k > LARGEST_K


@dataclass(frozen=True)
class DependenceScore:
    """Score of one quantity that follows a covariate besides the actuation."""

    quantity: str
    covariate: str  # "velocity", "amplitude", or "" for neither
    elpd: Figure  # sum of the log predictive densities of tests that were left out, in prior units
    difference: Figure  # difference from the score of neither, and its standard error
    se: Figure
