"""Draws of dampers whose actuation changes in time."""

import numpy as np
import pytest

from mfd_bayes.population.along import Along
from mfd_bayes.response.building import read_building
from mfd_bayes.response.choice import Choice
from mfd_bayes.response.draws import draw_dampers

BUILDING = """
[building]
title = "Two storeys"
[[storey]]
weight = "20 kip"
height = "144 in"
stiffness = "8 kip/in"
[[storey]]
weight = "20 kip"
height = "144 in"
stiffness = "8 kip/in"
"""
HISTORY = """
[[damper]]
storey = {storey}
actuation = {{ file = "valve.csv", column = "pressure_ksi", unit = "ksi" }}
"""
CONSTANT = """
[[damper]]
storey = {storey}
actuation = "1000 psi"
"""
SD = 0.3
CHOICE = Choice(kind="device", draws=2000, session="another")


@pytest.fixture(scope="module")
def study(benchmark_module):
    """Levels of actuation deviate from the laws."""
    return benchmark_module("given.study").make_study(level_sd=SD)


def dampers(study, folder, last, text=HISTORY):
    """Those of two storeys, whose actuation goes from 1 ksi to another."""
    (folder / "valve.csv").write_text(
        f"time_s,pressure_ksi\n0,1\n1,1\n1.01,{last}\n2.01,{last}\n", encoding="utf-8"
    )
    path = folder / "building.toml"
    path.write_text(BUILDING + text.format(storey=1) + text.format(storey=2), encoding="utf-8")
    predictor = study.predictor
    return draw_dampers(predictor.population, predictor.model, read_building(path), CHOICE)


def test_a_history_that_never_changes_is_the_constant(study, tmp_path):
    history, constant = (dampers(study, tmp_path, 1, text) for text in (HISTORY, CONSTANT))
    np.testing.assert_allclose(history.theta, constant.theta)
    np.testing.assert_allclose(history.scales["Fc_fwd"], 1.0)
    assert history.scales["Fc_fwd"].shape == (CHOICE.draws, 2, history.times.size)


def test_dampers_of_a_building_deviate_from_the_laws_alike(study, tmp_path, monkeypatch):
    column = [quantity.name for quantity in study.predictor.model.quantities].index("Fc_fwd")

    def forward(found):
        """Logarithms of the first damper's forward slip force at 1 and at 2 ksi."""
        return np.log(found.theta[:, 0, column, None] * found.scales["Fc_fwd"][:, 0][:, [0, -1]])

    found = dampers(study, tmp_path, 2)
    np.testing.assert_array_equal(found.scales["Fc_fwd"][:, 0], found.scales["Fc_fwd"][:, 1])
    slip = forward(found)
    # the sd is in inverse proportion to the actuation, and levels one octave apart are related
    np.testing.assert_allclose(slip.std(axis=0), [SD, SD / 2.0], rtol=0.15)
    assert np.corrcoef(slip.T)[0, 1] < 0.75
    monkeypatch.setattr(Along, "size", 0)  # the control: the laws hold along the history
    monkeypatch.setattr(Along, "factors", lambda *_: {})
    assert np.corrcoef(forward(dampers(study, tmp_path, 2)).T)[0, 1] > 0.95
