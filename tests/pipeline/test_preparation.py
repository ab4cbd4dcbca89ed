"""Pictures of records before a calibration."""

import numpy as np
import pytest

from mfd_bayes.pipeline.preparation import prior_check
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
