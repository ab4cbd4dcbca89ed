"""Pictures of records before a calibration."""

import numpy as np
import pytest

from mfd_bayes.pipeline.inspect import prior_check
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
