from dataclasses import replace

import pytest

from mfd_bayes.evaluation.laws import law_choices, law_label, law_score_rows
from mfd_bayes.population.law_scores import LawScore


def scores(**levels):
    """Scores of the laws of one quantity, from their terms at three levels."""
    return [
        LawScore("Fc_fwd", law, sum(terms), 0.5, 1.0 / len(levels), tuple(terms))
        for law, terms in levels.items()
    ]


def choice(scores, law):
    """Rows of the laws of one quantity, and the sentence."""
    rows = law_score_rows(scores, {"Fc_fwd": law})
    return rows, law_choices(rows, {"Fc_fwd": law})["Fc_fwd"]


def test_the_best_law_stands_first_and_others_are_measured_by_it():
    found = scores(proportional=[1.0, 2.0, 0.0], power=[2.0, 3.0, 1.5])
    (best, other), sentence = choice(found, "proportional")
    assert (best["law"], best["difference"], best["difference_se"]) == ("power", 0.0, 0.0)
    assert other["difference"] == pytest.approx(-3.5)
    assert other["difference_se"] == pytest.approx(0.5)  # √3 times the sd of −1, −1, −1.5
    assert (best["chosen"], other["chosen"]) == (False, True)
    assert "the campaign's own, proportional, is worse by 3.5 ± 0.5" in sentence
    assert "cannot separate" not in sentence


def test_a_difference_within_its_standard_error_is_cautioned():
    found = scores(proportional=[1.0, 2.0, 0.0], power=[2.0, 1.0, 0.5], constant=[-9.0, -8.0, -9.0])
    _, sentence = choice(found, "proportional")
    assert sentence.startswith("the power law predicts levels that were left out best, but")
    assert "the 3 levels cannot separate it from proportional:" in sentence
    assert "constant" not in sentence
    assert "is worse" not in sentence


def test_compared_laws_are_named_with_their_weights():
    found = scores(proportional=[1.0, 2.0, 0.0], power=[2.0, 3.0, 1.5])
    rows, sentence = choice(found, "compare")
    assert sentence.endswith("mix them (compared: power 0.5, proportional 0.5).")
    assert not any(row["chosen"] for row in rows)
    weights = {"proportional": 0.3, "affine": 0.0, "power": 0.7}
    assert law_label("compare", weights) == "compared: power 0.7, proportional 0.3"
    assert law_label("power", {"power": 1.0}) == "power"


def test_a_score_that_cannot_be_trusted_is_named_and_never_best():
    found = [*scores(proportional=[1.0, 2.0, 0.0]), *scores(power=[9.0, 9.0, 9.0])]
    found[1] = replace(found[1], pareto_k=0.93, weight=0.0)
    rows, sentence = choice(found, "compare")
    assert [row["law"] for row in rows] == ["proportional", "power"]
    assert sentence.startswith("the proportional law predicts")
    assert "the score of power (Pareto k 0.93) cannot be trusted" in sentence
    _, none = choice([replace(s, pareto_k=1.5) for s in found], "compare")
    assert none.startswith("the laws have no weights; the score of power (Pareto k 1.50)")
    _, control = choice([replace(s, pareto_k=0.6) for s in found], "compare")
    assert "trusted" not in control  # the control
