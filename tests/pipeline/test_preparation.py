"""Pictures of records before a calibration."""

import json
import tomllib
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

import mfd_bayes as mb
from mfd_bayes.calibration.priors import Prior, find_priors, load_priors
from mfd_bayes.cli.commands import app
from mfd_bayes.pipeline.prior_check import prior_check
from mfd_bayes.reporting import figures

CAMPAIGN = """
[campaign]
priors = "mfd"

[columns]
time = {{ name = "time_s" }}
displacement = {{ name = "displacement_{length}" }}
force = {{ name = "force_{force}" }}

[[test]]
id = "a"
file = "a.csv"
actuation = "500 psi"
"""


@pytest.mark.parametrize(
    ("length", "force", "by"), [("in", "kip", (1.0, 1.0)), ("mm", "kN", (25.4, 4.4482216))]
)
def test_a_prior_check_is_drawn_in_the_units_of_the_record(
    tmp_path, monkeypatch, length, force, by
):
    time = np.linspace(0.0, 6.0, 301)
    motion, measured = np.sin(np.pi * time), np.sign(np.cos(np.pi * time))
    columns = np.column_stack([time, motion * by[0], measured * by[1]])
    head = f"time_s,displacement_{length},force_{force}"
    np.savetxt(tmp_path / "a.csv", columns, "%.9g", ",", header=head, comments="")
    (tmp_path / "campaign.toml").write_text(CAMPAIGN.format(length=length, force=force))
    drawn = []
    draw = figures.draw_loops
    monkeypatch.setattr(figures, "draw_loops", lambda *a: drawn.append(a) or draw(*a))
    ((name, share, picture),) = prior_check(tmp_path / "campaign.toml", tmp_path).tests
    ((_, trace, (fan,), system),) = drawn
    assert (name, system.length, system.force) == ("a", length, force)
    assert trace.displacement.max() == pytest.approx(by[0], rel=1e-3)
    inside = (trace.force >= fan.intervals[-1].lower) & (trace.force <= fan.intervals[-1].upper)
    assert inside.mean() == pytest.approx(share)
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("levels", "unloaded", "outside"),
    [
        ({"a": (1.0, 500), "z": (0.05, 0)}, ("z",), ()),
        ({"a": (1.0, 500), "b": (0.05, 500), "z": (0.05, 0)}, ("z",), ("b",)),
        ({"z": (0.05, 0)}, (), ("z",)),  # no other test says what the priors are of
    ],
)
def test_tests_without_actuation_are_only_noted_where_others_have_one(
    tmp_path, monkeypatch, levels, unloaded, outside
):
    monkeypatch.setattr(figures, "to_png", lambda _: b"\x89PNG")
    time = np.linspace(0.0, 6.0, 301)
    head, *_ = CAMPAIGN.format(length="in", force="kip").partition("[[test]]")
    for name, (force, level) in levels.items():
        columns = np.column_stack(
            [time, np.sin(np.pi * time), force * np.sign(np.cos(np.pi * time))]
        )
        names = "time_s,displacement_in,force_kip"
        np.savetxt(tmp_path / f"{name}.csv", columns, "%.9g", ",", header=names, comments="")
        head += f'[[test]]\nid = "{name}"\nfile = "{name}.csv"\nactuation = "{level} psi"\n'
    (tmp_path / "campaign.toml").write_text(head)
    found = prior_check(tmp_path / "campaign.toml", tmp_path)
    assert (found.unloaded, found.outside) == (unloaded, outside)
    assert bool(found.wrong) == bool(outside)


@pytest.mark.parametrize("median", ["0.02", "0.05"])
def test_a_prior_check_names_the_median_that_the_file_gives(tmp_path, monkeypatch, median):
    """That of 1001 fixed draws was low for every log-normal, the more the larger its spread."""
    monkeypatch.setattr(figures, "to_png", lambda _: b"\x89PNG")
    time = np.linspace(0.0, 6.0, 301)
    columns = np.column_stack([time, np.sin(np.pi * time), 2.0 * np.sign(np.cos(np.pi * time))])
    names = "time_s,displacement_in,force_kip"
    np.savetxt(tmp_path / "a.csv", columns, "%.9g", ",", header=names, comments="")
    content = tomllib.loads((find_priors("mfd")).read_text(encoding="utf-8"))
    priors = []
    for name, prior in content["parameters"].items():
        if name in ("Fc_fwd", "Fc_bwd"):
            prior = {"family": "lognormal", "median": f"{median} kip", "spread": 0.1}
        lines = (f"{key} = {json.dumps(value)}" for key, value in prior.items())
        priors.append("\n".join([f"[parameters.{name}]", *lines]))
    for name, group in content["scatter"].items():
        lines = (f"{key} = {json.dumps(value)}" for key, value in group.items())
        priors.append("\n".join([f"[scatter.{name}]", *lines]))
    (tmp_path / "own.toml").write_text("\n".join(priors), encoding="utf-8")
    campaign = tmp_path / "campaign.toml"
    campaign.write_text(CAMPAIGN.format(length="in", force="kip").replace('"mfd"', '"own.toml"'))
    said = CliRunner().invoke(app, ["prior-check", str(campaign), "-o", str(tmp_path / "out")])
    assert f"its median is {median} kip" in " ".join(said.output.split())


@pytest.mark.parametrize(("stroke", "masked"), [(1.03, True), (0.97, False)])
def test_a_start_mask_ends_after_twice_the_gap_that_the_priors_give(tmp_path, stroke, masked):
    """The gap is the sum of the medians of d2 and d3."""
    file = load_priors("mfd")
    gap = {"median": 0.1, "spread": 0.7}
    own = {name: Prior("lognormal", gap) for name in ("d2", "d3")}
    file = replace(file, parameters=file.parameters | own)
    time = np.linspace(0.0, 8.0, 801)
    motion = 0.5 * stroke * 0.4 * -np.cos(np.pi * time)
    trace = mb.Trace.from_arrays(time, motion, actuation=1.0, force=np.sign(np.sin(np.pi * time)))
    if masked:
        assert mb.Posterior(trace, file, start="mask").first == 100
    else:
        with pytest.raises(mb.MfdError, match="twice the prior's gap"):
            mb.Posterior(trace, file, start="mask")
