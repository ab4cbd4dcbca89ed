"""What is said of tests at zero actuation."""

import pytest

from mfd_bayes.calibration.priors import load_priors
from mfd_bayes.evaluation.verdict import zero_pressure_sentences
from mfd_bayes.population.design import design_of
from mfd_bayes.population.settings import Setting

NAMES = ("Fc_fwd", "Fc_bwd", "sigma0", "k3")
IDS = ("idle", "low", "high")


def sentences(laws, levels=(0.0, 0.5, 1.0)):
    design = design_of(load_priors("mfd"), NAMES, [Setting(p) for p in levels], laws)
    return zero_pressure_sentences(design, IDS)


def test_laws_that_do_not_learn_from_a_test_at_zero_are_named():
    (sentence,) = sentences({"Fc_bwd": "affine"})
    assert "from idle nothing is learned about Fc_fwd (proportional)." in sentence
    assert "Fc_bwd" not in sentence


@pytest.mark.parametrize(
    ("laws", "levels"),
    [
        (dict.fromkeys(("Fc_fwd", "Fc_bwd"), "residual_power"), (0.0, 0.5, 1.0)),
        ({}, (0.2, 0.5, 1.0)),
    ],
)
def test_nothing_is_said_where_every_test_informs_every_law(laws, levels):
    assert sentences(laws, levels) == []
