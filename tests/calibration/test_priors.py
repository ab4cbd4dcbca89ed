"""Families of priors beside scipy's, and the files that hold them."""

import itertools
from pathlib import Path

import numpy as np
import pytest
from scipy import integrate, stats

from mfd_bayes.calibration.priors import Prior, find_priors, known_quantities, load_priors
from mfd_bayes.errors import PriorError

SHIPPED = sorted(p.stem for p in (Path(__file__).parents[2] / "priors").glob("*.toml"))
CASES = {
    "lognormal": (Prior("lognormal", {"median": 2.0, "sigma": 0.7}), stats.lognorm(0.7, scale=2)),
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
    "half_normal": (Prior("half_normal", {"sd": 0.3}), stats.halfnorm(scale=0.3)),
    "uniform": (Prior("uniform", {"lower": 0.2, "upper": 3.0}), stats.uniform(0.2, 2.8)),
    "gamma": (Prior("gamma", {"shape": 2.0, "scale": 0.1}), stats.gamma(2.0, scale=0.1)),
    "beta": (Prior("beta", {"a": 2.0, "b": 5.0}), stats.beta(2.0, 5.0)),
}


@pytest.mark.parametrize(("prior", "law"), CASES.values(), ids=CASES)
def test_a_family_is_scipys(prior, law):
    x = law.ppf(np.linspace(0.001, 0.999, 41))
    q, step = prior.coordinate(x), 1e-4
    np.testing.assert_allclose(prior.value(q), x, rtol=1e-12)
    assert np.all(np.diff(q) > 0)
    slope = (prior.value(q + step) - prior.value(q - step)) / (2 * step)
    np.testing.assert_allclose(prior.log_density(q), law.logpdf(x) + np.log(slope), atol=1e-6)
    assert prior.median == pytest.approx(law.ppf(0.5), rel=1e-9)
    # normalised, and low but a number far out
    low, middle, high = prior.coordinate(law.ppf([1e-9, 0.5, 1 - 1e-9]))
    edges = np.linspace(3 * low - 2 * middle, 3 * high - 2 * middle, 80)
    mass = sum(
        integrate.fixed_quad(lambda q: np.exp(prior.log_density(q)), a, b, n=20)[0]
        for a, b in itertools.pairwise(edges)
    )
    assert mass == pytest.approx(1.0, abs=1e-6)
    far = prior.log_density(np.array([-1e4, -800.0, 800.0, 1e4, np.inf, -np.inf]))
    assert np.all(far < prior.log_density(q).min())
    # draws; the control: an error of an eighth of a standard deviation is detected
    draws = prior.draw(np.random.default_rng(11), 4000)
    assert stats.kstest(draws, law.cdf).pvalue > 0.001
    assert stats.kstest(draws + law.std() / 8, law.cdf).pvalue < 0.001


GOOD = 'family = "lognormal"\nmedian = "2 kip"\nsigma = 0.7\nreason = "r"\n'
SPARSE = '[scatter.k]\nparameters = ["k3"]\nabove = 0.2\nprobability = 0.05\n'
STATED = '[scales]\nforce = "1.5 kip"\nlength = "0.25 in"\nspeed = "3 in/s"\n'


def prior_text(body, name="Fc_fwd"):
    return f"[parameters.{name}]\n{body}"


def multiple(value="1 force", scales=STATED):
    return scales + prior_text(f'family = "lognormal"\nmedian = "{value}"\nsigma = 1\n')


def write(folder, text):
    path = folder / "mine.toml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


@pytest.mark.parametrize(
    ("text", "name"),
    [
        (prior_text('family = "cauchy"\n'), "Fc_fwd"),
        (prior_text('family = "lognormal"\nmedian = "2 kip"\n'), "sigma"),
        (prior_text('family = "lognormal"\nmedian = "-2 kip"\nsigma = 1\n'), "median"),
        (prior_text('family = "lognormal"\nmedian = "2 in"\nsigma = 1\n'), "median"),
        (prior_text('family = "lognormal"\nmedian = "2 kip"\nsigma = nan\n'), "sigma"),
        (prior_text('family = "uniform"\nlower = "1 kip"\nupper = "1 kip"\n'), "upper"),
        (prior_text('family = "truncated_normal"\nmean = "0 kip"\nsd = "1 kip"\n'), "lower"),
        (prior_text(f'family = "normal"\nmean = "1 kip"\nsd = {10**400}\n', "offset"), "sd"),
        (prior_text(GOOD, "Fc_forward"), "Fc_forward"),
        ("[parameters\n", "TOML"),
        ("[priors.Fc_fwd]\n", "priors"),
        ("parameters = 3\n", "parameters"),
        ('[scatter.friction]\nparameters = ["Fc"]\nsd = 0.1\n', "Fc"),
        ('[scatter.friction]\nparameters = [["Fc_fwd"]]\nsd = 0.1\n', "Fc_fwd"),
        ('[scatter.friction]\nparameters = "Fc_fwd"\nsd = 0.1\n', "parameters"),
        ('[scatter.k]\nparameters = ["k3"]\nabove = 0.2\n', "probability"),
        (f"{SPARSE}sd = 0.1\n", "sd"),
        (SPARSE.replace("0.2", "-1"), "above"),
        (SPARSE.replace("k3", "offset"), "above"),
        (multiple(scales=""), "init"),
        (multiple(scales='[scales]\nforce = "7 N"\n'), "length"),
        (multiple(scales=STATED.replace("1.5 kip", "-1 kip")), "force"),
        (multiple("1 length"), "median"),
        ('[measurement]\nforc = "0.5 %"\n', "measurement"),
        ("measurement = 3\n", "measurement"),
        ('[measurement]\nforce = "25 %"\n', "force must be below 20%"),
        ('[measurement]\nforce = "-1 %"\n', "force"),
        ('[measurement]\nforce = "1 kip"\n', "force"),
        (f'[parameters.{"x" * 9000}]\nfamily = "normal"', "xxx"),
    ],
)
def test_a_bad_file_is_refused_by_one_short_sentence(tmp_path, text, name):
    with pytest.raises(PriorError, match=name) as caught:
        load_priors(str(write(tmp_path, text)))
    sentence = str(caught.value)
    assert "mine.toml" in sentence
    assert "\n" not in sentence
    assert len(sentence) <= 1000


def test_a_prior_file_may_state_how_well_gains_are_known(tmp_path):
    text = '[measurement]\nforce = "0.5 %"\ndisplacement = 0.002\n'
    stated = load_priors(str(write(tmp_path, text))).measurement
    assert stated == pytest.approx({"force": 0.005, "displacement": 0.002})
    assert load_priors("mfd").measurement == {}


def test_a_scatter_that_is_likely_none_is_exponential(tmp_path):
    offset = SPARSE.replace("k3", "offset").replace("[scatter.k]", "[scatter.offset]")
    half_normal = '[scatter.friction]\nparameters = ["Fc_fwd"]\nsd = 0.1\n'
    text = SPARSE + offset.replace("0.2", '"0.4448222 kN"') + half_normal
    scatter = load_priors(str(write(tmp_path, text))).scatter
    for name, threshold in (("k", 0.2), ("offset", 0.1)):
        assert scatter[name].sparse
        assert stats.expon(scale=scatter[name].sd).sf(threshold) == pytest.approx(0.05, rel=1e-5)
    assert not scatter["friction"].sparse
    assert scatter["friction"].sd == 0.1


def test_priors_are_found_by_name_and_by_path_inside_the_campaigns_folder(tmp_path):
    assert find_priors("mfd").name == "mfd.toml"
    path = write(tmp_path, prior_text(GOOD))
    assert find_priors(str(path)) == find_priors("mine.toml", tmp_path) == path
    for name in ("mdf", "../priors/mfd", "", "."):
        with pytest.raises(PriorError, match=", ".join(SHIPPED)):
            find_priors(name, tmp_path)
    folder = tmp_path / "campaign"
    folder.mkdir()
    (folder / "link.toml").symlink_to(path)
    for name in (f"../{path.name}", str(path), "link.toml"):
        with pytest.raises(PriorError, match="outside"):
            find_priors(name, folder)
    with pytest.raises(PriorError, match="cannot be found"):
        find_priors("x" * 5000, folder)


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_priors_are_complete_and_say_why(name, tmp_path):
    if name == "any":  # ratios, of scales that a user states
        text = (Path(__file__).parents[2] / "priors/any.toml").read_text(encoding="utf-8")
        write(tmp_path, text.replace("[parameters.sigma0]", f"{STATED}[parameters.sigma0]"))
    file = load_priors("mine.toml", tmp_path) if name == "any" else load_priors(name)
    assert set(file.parameters) == {n for n, q in known_quantities().items() if q.sampled}
    for entries in (file.parameters, file.scatter):
        assert all(len(entry.reason) > 5 for entry in entries.values())
    members = [member for scatter in file.scatter.values() for member in scatter.parameters]
    assert len(members) == len(set(members))
    assert 0.05 < file.gap < 1.0
    assert all(file.parameters[f"static_excess_{side}"].lower >= 0 for side in ("fwd", "bwd"))
    if name == "any":
        medians = {key: prior.figures.get("median") for key, prior in file.parameters.items()}
        assert medians["Fc_fwd"] == pytest.approx(1.5)
        assert medians["k3"] == pytest.approx(2 * 1.5 / 0.25)
        assert medians["sigma2"] == pytest.approx(0.03 * 1.5 / 3)
        assert medians["noise_time"] == pytest.approx(0.5 * 0.25 / 3)


def test_the_old_name_of_sigma_is_refused_with_the_new_one():
    with pytest.raises(PriorError, match="spread is sigma now"):
        Prior("lognormal", {"median": 2.0, "spread": 0.5})
