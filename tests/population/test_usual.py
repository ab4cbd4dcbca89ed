"""What slip forces follow where a campaign does not say."""

import pytest

from mfd_bayes.friction.models import MODELS
from mfd_bayes.population.inference import usual_dependence
from mfd_bayes.population.settings import Setting

NAMES = ("Fc_fwd", "Fc_bwd", "sigma0", "d2")


def settings_of(amplitudes, velocities):
    covariates = zip(amplitudes, velocities, strict=True)
    return [Setting(0.8, "", {"amplitude": a, "velocity": v}) for a, v in covariates]


@pytest.mark.parametrize(
    ("amplitudes", "expected"),
    [([0.5, 1.0, 1.5, 1.0], ("amplitude",)), ([1.0, 1.1, 1.0, 1.0], ()), ([0.5, 1.0, 1.5], ())],
)
def test_slip_forces_follow_the_stroke_where_enough_tests_differ_in_it(amplitudes, expected):
    velocities = [1.0, 2.0, 4.0, 8.0][: len(amplitudes)]  # which the friction model knows
    under = settings_of(amplitudes, velocities)
    found = usual_dependence(MODELS["three_stage"], under, NAMES)
    assert found == ({"Fc_fwd": expected, "Fc_bwd": expected} if expected else {})
