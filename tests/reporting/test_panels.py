"""Panels whose axes serve again show what new ones would show."""

from contextlib import nullcontext

import numpy as np
import pytest

from mfd_bayes.evaluation.views import Marginal
from mfd_bayes.reporting.figures import panels
from mfd_bayes.reporting.figures.panels import Sheets
from mfd_bayes.reporting.figures.posteriors import draw_chains, draw_corner, draw_marginals
from mfd_bayes.reporting.figures.style import to_png

NAMES = ("Fc_fwd", "k3", "d2", "v_s", "sigma0")


def marginals(seed, number=4, contraction=0.9):
    """Of which the first has no spread, and some priors are wide and some are not."""
    rng = np.random.default_rng(seed)
    found = [Marginal(NAMES[0], "kip", np.full(500, 2.0), np.full(200, 2.0), contraction)]
    for i, name in enumerate(NAMES[1:number]):
        wide = (i + seed) % 2
        prior = np.exp(rng.normal(seed, 2.0, 500)) if wide else rng.uniform(seed - 1, seed, 500)
        found.append(Marginal(name, "kip", prior, prior[:200], contraction))
    return found


def chains(seed, number=5):
    rng = np.random.default_rng(seed)
    return {name: rng.normal(100.0 * seed, seed, (4, 40)) for name in NAMES[:number]}


CASES = {
    "chains": (
        lambda seed: draw_chains(f"test {seed}", chains(seed), {}),
        lambda seed: draw_chains("fewer", chains(seed, 3), {}),
    ),
    "marginals": (
        lambda seed: draw_marginals("a", marginals(seed, 5, 0.2 * seed)),
        lambda seed: draw_marginals("fewer", marginals(seed, 3)),
    ),
    "corner": (
        lambda seed: draw_corner("a", marginals(seed, 5), NAMES),
        lambda seed: draw_corner("fewer", marginals(seed, 4), NAMES),
    ),
}


def drawn(draw, sheets):
    """One test after the other, with another number of panels between them."""
    with sheets:
        return [to_png(one(seed)) for seed in (1, 2, 3) for one in draw]


@pytest.mark.parametrize("kind", CASES)
def test_used_again_they_are_the_same_to_the_byte(kind):
    """Other limits, scales, titles and numbers of lines leave no trace."""
    new = drawn(CASES[kind], nullcontext())
    assert len(set(new)) == len(new)
    assert drawn(CASES[kind], Sheets().in_use()) == new


@pytest.mark.parametrize("kind", CASES)
def test_what_is_not_emptied_shows(kind, monkeypatch):
    """The control of the test above."""
    monkeypatch.setattr(panels, "_empty", lambda *_: None)
    assert drawn(CASES[kind], Sheets().in_use()) != drawn(CASES[kind], nullcontext())


@pytest.mark.parametrize("draw", [draw for draw, _ in CASES.values()])
def test_a_figure_is_given_again_only_where_it_may_be(draw):
    with Sheets().in_use():
        assert draw(1) is draw(2)
    assert draw(1) is not draw(2)


def test_kinds_do_not_share_a_figure():
    with Sheets().in_use():
        assert panels.in_rows("chains", "a", 4)[0] is not panels.in_rows("marginals", "a", 4)[0]
