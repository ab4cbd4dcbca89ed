"""Parts of a run that are left out."""

import pytest

from mfd_bayes.errors import CampaignError
from mfd_bayes.population.setting import Setting
from mfd_bayes.validation.folds import parts_of


def settings(*levels):
    return {f"t{i}": Setting(level) for i, level in enumerate(levels)}


def test_the_level_without_actuation_is_a_part():
    found = parts_of(settings(0.0, 0.03, 0.0, 0.036), "level", "kip", "a.toml")
    assert found == {"0 lbf": ("t0", "t2"), "30 lbf": ("t1",), "36 lbf": ("t3",)}


@pytest.mark.parametrize(("by", "part"), [("level", "30 lbf"), ("test", "t1")])
def test_all_tests_with_an_actuation_cannot_be_left_out(by, part):
    with pytest.raises(CampaignError, match=f"cannot leave out {part}: no other calibrated test"):
        parts_of(settings(0.0, 0.03), by, "kip", "a.toml")
