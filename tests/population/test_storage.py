import warnings

import numpy as np
import pytest

from mfd_bayes.calibration.diagnostics import Convergence
from mfd_bayes.calibration.prior_files import load_priors
from mfd_bayes.errors import StoreError
from mfd_bayes.population.hierarchy import Population, pool
from mfd_bayes.population.marginal import Pooling
from mfd_bayes.population.storage import load_population, save_population


@pytest.fixture(scope="module")
def priors():
    return load_priors("mfd")


@pytest.fixture(scope="module")
def population(priors):
    names = ("sigma0", "Fc_fwd", "Fc_bwd", "static_excess_fwd", "static_excess_bwd", "offset")
    laws = {"Fc_fwd": "power", "Fc_bwd": "proportional", "sigma0": "affine"}
    pooling = pool(priors, names, [0.5, 0.8, 1.5], laws)
    rng = np.random.default_rng(1)
    return Population(
        pooling=pooling,
        levels=pooling.centre + 0.1 * rng.normal(size=(4, 60, 6)),
        shapes={name: rng.normal(1, 0.3, size=(4, 60)) for name in pooling.shaped},
        scatter=np.abs(rng.normal(0.1, 0.02, size=(4, 60, len(pooling.groups)))),
        priors={name: priors.parameters[name] for name in names},
        actuation_unit="ksi",
        walkers=6,
        convergence=Convergence(np.array([1.001, 1.0]), np.array([500.0, 6e3]), np.ones(2)),
    )


def test_a_population_comes_back_bit_by_bit(tmp_path, priors, population):
    save_population(tmp_path / "population.nc", population)
    back = load_population(tmp_path / "population.nc", priors)
    np.testing.assert_array_equal(back.levels, population.levels)
    np.testing.assert_array_equal(back.scatter, population.scatter)
    assert back.shapes.keys() == population.shapes.keys() == {"Fc_fwd", "sigma0"}
    for name, shape in population.shapes.items():
        np.testing.assert_array_equal(back.shapes[name], shape)
    for name in Pooling.__dataclass_fields__:
        np.testing.assert_array_equal(
            getattr(back.pooling, name), getattr(population.pooling, name)
        )
    for name in Convergence.__dataclass_fields__:
        expected = getattr(population.convergence, name)
        np.testing.assert_array_equal(getattr(back.convergence, name), expected)
    assert (back.actuation_unit, back.walkers) == ("ksi", 6)


def test_what_is_derived_is_the_same_after_the_round_trip(tmp_path, priors, population):
    save_population(tmp_path / "population.nc", population)
    back = load_population(tmp_path / "population.nc", priors)
    assert back.slopes.keys() == population.slopes.keys()
    assert "K_c_bwd" in back.slopes
    assert "K_c_fwd" not in back.slopes  # its law has no slope
    for name, slope in population.slopes.items():
        np.testing.assert_array_equal(back.slopes[name], slope)
    grid = np.array([0.0, 0.3, 2.0])
    for name in ("Fc_fwd", "sigma0", "offset"):
        np.testing.assert_array_equal(back.median(name, grid), population.median(name, grid))


def test_arviz_reads_the_file_by_the_papers_names(tmp_path, population):
    path = tmp_path / "population.nc"
    save_population(path, population)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)
        import arviz as az
    data = az.from_netcdf(path)
    slope = data.posterior["K_c_bwd"]
    assert slope.dims == ("chain", "draw")
    np.testing.assert_array_equal(slope, population.slopes["K_c_bwd"])
    assert "scatter_friction" in data.posterior


def test_a_missing_file_is_said_to_be_missing(tmp_path, priors):
    with pytest.raises(StoreError, match=r"nothing\.nc does not exist"):
        load_population(tmp_path / "nothing.nc", priors)


def test_a_file_of_another_kind_is_refused(tmp_path, priors):
    (tmp_path / "population.nc").write_text("time_s,force_kip\n0,1\n")
    with pytest.raises(StoreError, match=r"population\.nc"):
        load_population(tmp_path / "population.nc", priors)
