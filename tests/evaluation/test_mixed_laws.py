"""Constants of each law where laws are compared."""

from types import SimpleNamespace

import numpy as np
import pytest

from mfd_bayes.evaluation.laws import FEWEST, mixed_rows
from mfd_bayes.friction.three_stage import ThreeStage
from mfd_bayes.population.laws import LAW_NAMES
from mfd_bayes.runs.unit_system import US

REFERENCE = 2.0  # ksi
NUMBER = {name: number for number, name in enumerate(LAW_NAMES)}


class Mixed:
    """Population of 4 chains × 50 draws; a quarter of the chains has each of four laws."""

    laws = ("proportional", "affine", "power", "constant")

    def __init__(self, name="Fc_fwd", draws=50):
        laws = {"sigma0": "proportional", name: "compare"}
        self.design = SimpleNamespace(laws=laws, reference=REFERENCE)
        self.law_weights = {name: dict.fromkeys(self.laws, 0.25)}
        of_chain = np.array([[NUMBER[law]] * draws for law in self.laws])
        self.choice = np.stack([np.zeros_like(of_chain), of_chain], axis=-1)

    def median(self, name, actuation):
        level = np.array([3.0, 4.0, 5.0, 6.0])  # kip at the reference, by chain
        return np.broadcast_to(level[:, None, None], (*self.choice.shape[:2], 1))

    def shapes(self, name):
        share = np.broadcast_to(np.array([1.0, 0.75, 1.0, 0.0])[:, None], self.choice.shape[:2])
        exponent = np.broadcast_to(np.array([1.0, 1.0, 0.6, 1.0])[:, None], self.choice.shape[:2])
        return share, exponent


def run_of(population, system=US):
    """What the rows need of a run."""
    return SimpleNamespace(
        population=population, actuation_unit="ksi", system=system, model=ThreeStage()
    )


def table(population, system=US):
    rows = mixed_rows(run_of(population, system), "2 ksi")
    return {(row["note"].split(" law")[0], row["name"]): row for row in rows}


def test_each_law_has_its_own_constants():
    found = table(Mixed())
    medians = {key: row["median"] for key, row in found.items()}
    assert medians == pytest.approx(
        {
            ("proportional", "K_c_fwd"): 1.5,
            ("affine", "K_c_fwd"): 1.5,  # 4 · 0.75 / 2
            ("affine", "Fc_fwd_0"): 1.0,
            ("power", "Fc_fwd"): 5.0,
            ("power", "exponent_Fc_fwd"): 0.6,
            ("constant", "Fc_fwd"): 6.0,
        }
    )
    assert found["affine", "Fc_fwd_0"]["note"] == "affine law, weight 0.25"
    assert found["power", "Fc_fwd"]["note"] == "power law, weight 0.25; at 2 ksi"
    units = {name: row["unit"] for (_, name), row in found.items()}
    assert units == {"K_c_fwd": "in^2", "Fc_fwd_0": "kip", "Fc_fwd": "kip", "exponent_Fc_fwd": "1"}
    assert all(np.isnan(row["r_hat"]) for row in found.values())  # a part of the chains
    assert mixed_rows(run_of(Mixed(draws=FEWEST - 1)), "") == []
