import itertools
from pathlib import Path

import numpy as np
import pytest
from scipy import integrate, stats

from mfd_bayes.calibration.priors import (
    FAMILIES,
    Prior,
    find_priors,
    load_priors,
    sampled_quantities,
)
from mfd_bayes.errors import PriorError

SHIPPED = sorted(p.stem for p in (Path(__file__).parents[2] / "priors").glob("*.toml"))

CASES = {
    "lognormal": (Prior("lognormal", {"median": 2.0, "spread": 0.7}), stats.lognorm(0.7, scale=2)),
    "normal": (Prior("normal", {"mean": -1.0, "sd": 0.2}), stats.norm(-1.0, 0.2)),
    "truncated above and below": (
        Prior("truncated_normal", {"mean": 1.0, "sd": 2.0, "lower": 0.5, "upper": 2.0}),
        stats.truncnorm(-0.25, 0.5, loc=1.0, scale=2.0),
    ),
    "truncated below": (
        Prior("truncated_normal", {"mean": 1.0, "sd": 2.0, "lower": -0.5}),
        stats.truncnorm(-0.75, np.inf, loc=1.0, scale=2.0),
    ),
    "truncated in the upper tail": (
        Prior("truncated_normal", {"mean": 0.0, "sd": 1.0, "lower": 9.0, "upper": 11.0}),
        stats.truncnorm(9.0, 11.0),
    ),
    "truncated in the lower tail": (
        Prior("truncated_normal", {"mean": 0.0, "sd": 1.0, "lower": -12.0, "upper": -9.0}),
        stats.truncnorm(-12.0, -9.0),
    ),
    "half_normal": (Prior("half_normal", {"sd": 0.3}), stats.halfnorm(scale=0.3)),
    "uniform": (Prior("uniform", {"lower": 0.2, "upper": 3.0}), stats.uniform(0.2, 2.8)),
    "gamma": (Prior("gamma", {"shape": 2.0, "scale": 0.1}), stats.gamma(2.0, scale=0.1)),
    "beta": (Prior("beta", {"a": 2.0, "b": 5.0}), stats.beta(2.0, 5.0)),
    "gamma, spiked at zero": (
        Prior("gamma", {"shape": 0.5, "scale": 3.0}),
        stats.gamma(0.5, scale=3.0),
    ),
}
EVERY = pytest.mark.parametrize(("prior", "law"), CASES.values(), ids=CASES)


def coordinates(prior, law, n=41):
    return prior.coordinate(law.ppf(np.linspace(0.001, 0.999, n)))


def numerical_jacobian(prior, q):
    step = 1e-4
    return (prior.value(q + step) - prior.value(q - step)) / (2 * step)


def test_every_family_is_tested():
    assert {prior.family for prior, _ in CASES.values()} | {"fixed"} == set(FAMILIES)


@EVERY
def test_density_is_scipys_with_the_jacobian(prior, law):
    q = coordinates(prior, law)
    expected = law.logpdf(prior.value(q)) + np.log(numerical_jacobian(prior, q))
    np.testing.assert_allclose(prior.log_density(q), expected, rtol=1e-6, atol=1e-6)


@EVERY
def test_density_of_the_coordinate_integrates_to_one(prior, law):
    ends = np.sort(prior.coordinate(law.ppf([1e-9, 0.5, 1 - 1e-9])))
    low, middle, high = ends
    pieces = np.concatenate(
        [
            np.linspace(3 * low - 2 * middle, middle, 40),
            np.linspace(middle, 3 * high - 2 * middle, 40),
        ]
    )
    mass = 0.0
    for a, b in itertools.pairwise(pieces):
        mass += integrate.fixed_quad(lambda q: np.exp(prior.log_density(q)), a, b, n=20)[0]
    assert mass == pytest.approx(1.0, abs=1e-6)


@EVERY
def test_values_and_coordinates_invert_each_other(prior, law):
    x = law.ppf(np.linspace(0.001, 0.999, 41))
    np.testing.assert_allclose(prior.value(prior.coordinate(x)), x, rtol=1e-12)
    assert np.all(np.diff(prior.coordinate(x)) > 0)


@EVERY
def test_draws_follow_the_law(prior, law):
    draws = prior.draw(np.random.default_rng(11), 4000)
    assert stats.kstest(draws, law.cdf).pvalue > 0.001
    # the control: an error of an eighth of a standard deviation is detected
    assert stats.kstest(draws + law.std() / 8, law.cdf).pvalue < 0.001
    again = prior.draw(np.random.default_rng(11), 4000)
    np.testing.assert_array_equal(draws, again)


@EVERY
def test_typical_value_is_the_median(prior, law):
    assert prior.typical == pytest.approx(law.ppf(0.5), rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("bounds", [(-1.0, 2.0), (6.0, np.inf), (30.0, 31.0), (-40.0, -38.0)])
def test_the_median_between_bounds_far_out_has_its_digits(bounds):
    lower, upper = bounds
    figures = {"mean": 0.0, "sd": 1.0, "lower": lower} | ({"upper": upper} if upper < 1e9 else {})
    expected = stats.truncnorm.ppf(0.5, lower, upper)
    assert Prior("truncated_normal", figures).typical == pytest.approx(expected, rel=1e-9)


@EVERY
@pytest.mark.parametrize("far", [-1e4, -800.0, 800.0, 1e4, np.inf, -np.inf])
def test_far_coordinates_have_low_density_and_no_nan(prior, law, far):
    density = prior.log_density(np.array([far]))[0]
    assert density < prior.log_density(coordinates(prior, law)).min()
    assert not np.isnan(density)


@pytest.mark.parametrize(
    ("family", "figures", "expected"),
    [
        ("lognormal", {"median": 1.0}, "median and spread"),
        ("lognormal", {"median": 1.0, "spread": 0.5, "sd": 1.0}, "median and spread"),
        ("lognormal", {"median": -1.0, "spread": 0.5}, "median must be positive"),
        ("normal", {"mean": 0.0, "sd": 0.0}, "sd must be positive"),
        ("gamma", {"shape": 0.0, "scale": 1.0}, "shape must be positive"),
        ("beta", {"a": 2.0, "b": 0.0}, "b must be positive"),
        ("uniform", {"lower": 1.0, "upper": 1.0}, "upper must be above lower"),
        ("truncated_normal", {"mean": 0.0, "sd": 1.0}, "lower"),
        ("half_normal", {"sd": np.nan}, "sd"),
    ],
)
def test_bad_figures_are_named(family, figures, expected):
    with pytest.raises(PriorError, match=expected):
        Prior(family, figures)


GOOD = 'family = "lognormal"\nmedian = "2 kip"\nspread = 0.7\nreason = "r"\n'


def write(folder, body, name="Fc_fwd"):
    path = folder / "mine.toml"
    path.write_text(f"[parameters.{name}]\n{body}", encoding="utf-8")
    return path


def test_figures_are_converted_to_internal_units(tmp_path):
    body = 'family = "normal"\nmean = "1000 lbf"\nsd = "4.4482216 kN"\n'
    prior = load_priors(str(write(tmp_path, body))).parameters["Fc_fwd"]
    assert prior.figures["mean"] == pytest.approx(1.0)
    assert prior.figures["sd"] == pytest.approx(1.0, rel=1e-6)


def test_a_truncated_normal_needs_its_lower_bound(tmp_path):
    body = 'family = "truncated_normal"\nmean = "0 kip"\nsd = "1 kip"\nupper = "0.5 kip"\n'
    with pytest.raises(PriorError, match=r"offset.*lower"):
        load_priors(str(write(tmp_path, body, "offset")))


@pytest.mark.parametrize(
    ("body", "expected"),
    [
        ('family = "cauchy"\n', "family must be one of lognormal"),
        ("", "family must be one of lognormal"),
        ('family = "lognormal"\nmedian = "2 kip"\n', "median and spread"),
        ('family = "lognormal"\nmedian = "2 kip"\nspread = -1\n', "spread must be positive"),
        ('family = "lognormal"\nmedian = "2 in"\nspread = 1\n', "median.*force"),
        ('family = "lognormal"\nmedian = "2 furlongforce"\nspread = 1\n', "median.*furlongforce"),
        ('family = "lognormal"\nmedian = 2.0\nspread = 1\n', "median.*unit"),
        ('family = "lognormal"\nmedian = true\nspread = 1\n', "median"),
        ('family = "lognormal"\nmedian = "2 kip"\nspread = nan\n', "spread.*finite"),
        ('family = "lognormal"\nmedian = "2 kip"\nspread = [1]\n', "spread"),
    ],
)
def test_a_bad_prior_names_its_parameter_and_file(tmp_path, body, expected):
    with pytest.raises(PriorError, match=rf"(?s)Fc_fwd in mine\.toml.*{expected}") as caught:
        load_priors(str(write(tmp_path, body)))
    assert "\n" not in str(caught.value)


def test_an_unknown_parameter_lists_the_known(tmp_path):
    with pytest.raises(PriorError, match=r"mine\.toml.*sigma0.*v_s"):
        load_priors(str(write(tmp_path, GOOD, name="Fc_forward")))


SPARSE = '[scatter.k]\nparameters = ["k3"]\nabove = 0.2\nprobability = 0.05\n'


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ("[parameters\n", "not valid TOML"),
        (b"\xff\xfe", "not valid TOML"),
        ("[priors.Fc_fwd]\n", "unknown key 'priors'"),
        ("parameters = 3\n", "must hold tables"),
        ("[parameters]\nFc_fwd = 3\n", "must hold tables"),
        ('[scatter.friction]\nparameters = ["Fc"]\nsd = 0.1\n', "'Fc'"),
        ('[scatter.friction]\nparameters = ["Fc_fwd"]\nsd = 0.0\n', "sd must be positive"),
        ('[scatter.friction]\nparameters = "Fc_fwd"\nsd = 0.1\n', "a list"),
        ('[scatter.friction]\nparameters = ["Fc_fwd"]\n', "sd"),
        ('[scatter.k]\nparameters = ["k3"]\nabove = 0.2\n', "above and probability"),
        ('[scatter.k]\nparameters = ["k3"]\nprobability = 0.05\n', "above and probability"),
        (f"{SPARSE}sd = 0.1\n", "expected the keys parameters"),
        (f"{SPARSE}below = 0.1\n", "expected the keys parameters"),
        (SPARSE.replace("0.2", "0.0"), "above must be positive, got 0"),
        (SPARSE.replace("0.2", "-1"), "above must be positive, got -1"),
        (SPARSE.replace("0.2", "true"), "above: expected a number"),
        (SPARSE.replace("0.2", "inf"), "above: must be finite"),
        (SPARSE.replace("0.2", '"0.2 kip"'), "above"),
        (SPARSE.replace("0.05", "0.0"), "probability must lie between 0 and 1, got 0"),
        (SPARSE.replace("0.05", "1.0"), "probability must lie between 0 and 1, got 1"),
        (SPARSE.replace("0.05", "nan"), "probability: must be finite"),
        (SPARSE.replace("0.05", '"often"'), "probability"),
        (SPARSE.replace("k3", "k33"), "unknown parameter 'k33'"),
        (SPARSE.replace("k3", "offset"), "above: expected a quantity with its unit"),
    ],
)
def test_a_bad_file_is_named(tmp_path, content, expected):
    path = tmp_path / "mine.toml"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(PriorError, match=expected) as caught:
        load_priors(str(path))
    assert "mine.toml" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_scatter_that_is_likely_none_is_exponential(tmp_path):
    path = tmp_path / "mine.toml"
    offset = SPARSE.replace("k3", "offset").replace("[scatter.k]", "[scatter.offset]")
    half_normal = '[scatter.friction]\nparameters = ["Fc_fwd"]\nsd = 0.1\n'
    path.write_text(SPARSE + offset.replace("0.2", '"0.4448222 kN"') + half_normal)
    scatter = load_priors(str(path)).scatter
    for name, above in (("k", 0.2), ("offset", 0.1)):
        assert scatter[name].sparse
        assert stats.expon(scale=scatter[name].sd).sf(above) == pytest.approx(0.05, rel=1e-5)
    assert not scatter["friction"].sparse
    assert scatter["friction"].sd == 0.1


def test_priors_are_found_by_name_and_by_path(tmp_path):
    assert find_priors("mfd").name == "mfd.toml"
    path = write(tmp_path, GOOD)
    assert find_priors(str(path)) == path
    assert find_priors("mine.toml", tmp_path) == path


@pytest.mark.parametrize("name", ["mdf", "../priors/mfd", "", "mfd.toml.bak", "."])
def test_an_unknown_name_lists_the_known(name, tmp_path):
    with pytest.raises(PriorError, match=", ".join(SHIPPED)):
        find_priors(name, tmp_path)


def test_a_campaigns_priors_stay_in_its_folder(tmp_path):
    path = write(tmp_path, GOOD)
    folder = tmp_path / "campaign"
    folder.mkdir()
    (folder / "link.toml").symlink_to(path)
    for name in (f"../{path.name}", str(path), "link.toml"):
        with pytest.raises(PriorError, match="lies outside"):
            find_priors(name, folder)
    with pytest.raises(PriorError, match="cannot be found"):
        find_priors("x" * 5000, folder)


def test_a_number_with_thousands_of_digits_is_refused(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(
        f'[parameters.static_excess_fwd]\nfamily = "lognormal"\nmedian = {10**400}\nsd = 1'
    )
    with pytest.raises(PriorError, match="must be finite"):
        load_priors(str(path))


STATED = '[scales]\nforce = "1.5 kip"\nlength = "0.25 in"\nspeed = "3 in/s"\n'


def shipped(name, folder):
    """A shipped prior file; the one of ratios with scales of a brake."""
    if name != "any":
        return load_priors(name)
    text = (Path(__file__).parents[2] / "priors/any.toml").read_text(encoding="utf-8")
    (folder / "own.toml").write_text(
        text.replace("[parameters.sigma0]", f"{STATED}[parameters.sigma0]")
    )
    return load_priors("own.toml", folder)


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_priors_are_complete_and_say_why(name, tmp_path):
    file = shipped(name, tmp_path)
    assert file.title
    assert set(file.parameters) == set(sampled_quantities())
    for entries in (file.parameters, file.scatter):
        assert all(len(entry.reason) > 5 for entry in entries.values())
    scattered = [member for scatter in file.scatter.values() for member in scatter.parameters]
    assert len(scattered) == len(set(scattered))
    assert 0.05 < file.gap < 1.0


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_priors_put_static_friction_above_kinetic_by_construction(name, tmp_path):
    for side in ("fwd", "bwd"):
        prior = shipped(name, tmp_path).parameters[f"static_excess_{side}"]
        assert prior.lower >= 0
        assert np.all(prior.draw(np.random.default_rng(0), 1000) >= 0)


@pytest.mark.parametrize(
    "text",
    [
        f'[parameters.d2]\nfamily = "{"x" * 9000}"',
        f'[parameters.{"x" * 9000}]\nfamily = "normal"',
        f'[parameters.d2]\nfamily = "lognormal"\n{"x" * 9000} = 1',
        f"{'x' * 9000} = 1",
    ],
)
def test_a_sentence_does_not_repeat_all_that_a_stranger_wrote(tmp_path, text):
    (tmp_path / "own.toml").write_text(text)
    with pytest.raises(PriorError, match=r"own\.toml") as caught:
        load_priors("own.toml", tmp_path)
    assert len(str(caught.value)) <= 1001


# --- multiples of a device's own scales


def test_multiples_are_of_the_stated_scales(tmp_path):
    priors = shipped("any", tmp_path).parameters
    assert priors["Fc_fwd"].figures["median"] == pytest.approx(1.5)
    assert priors["k3"].figures["median"] == pytest.approx(2 * 1.5 / 0.25)
    assert priors["sigma2"].figures["median"] == pytest.approx(0.03 * 1.5 / 3)
    assert priors["noise_time"].figures["median"] == pytest.approx(0.5 * 0.25 / 3)
    assert priors["v_s"].figures["median"] == pytest.approx(0.3)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "mfd-bayes init campaign.toml"),
        ('[scales]\nforce = "7 N"\n', "must hold force, length and speed"),
        (STATED.replace("1.5 kip", "1.5 in"), "measures length"),
        (STATED.replace("1.5 kip", "-1 kip"), "expected more than 0"),
        (STATED.replace('"1.5 kip"', "7"), "a quantity such as '7 N', got 7"),
    ],
)
def test_multiples_without_scales_are_refused(tmp_path, text, expected):
    content = f'{text}[parameters.Fc_fwd]\nfamily = "lognormal"\nmedian = "1 force"\nspread = 1\n'
    (tmp_path / "own.toml").write_text(content)
    with pytest.raises(PriorError, match=expected):
        load_priors("own.toml", tmp_path)


def test_a_multiple_of_the_wrong_measure_is_refused(tmp_path):
    text = f'{STATED}[parameters.Fc_fwd]\nfamily = "lognormal"\nmedian = "1 length"\nspread = 1\n'
    (tmp_path / "own.toml").write_text(text)
    with pytest.raises(PriorError, match="measures length"):
        load_priors("own.toml", tmp_path)
