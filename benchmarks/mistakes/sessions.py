"""Real sessions as folders of CSV files with a campaign file, before a mistake is planted."""

from __future__ import annotations

import csv
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

HEADER = """\
[campaign]
title = "{title}"
priors = "brfd"
"""

TEST = """
[[test]]
id = "{id}"
file = "{id}.csv"
actuation = "{actuation}"
columns = {{ time = {{ name = "time_s", unit = "s" }}, \
displacement = {{ name = "{displacement}" }}, force = {{ name = "{force}" }} }}
"""

NAMES = {"displacement": "displacement_in", "force": "force_kip"}


@dataclass(frozen=True)
class Planned:
    """A test as it is written: its table in s, in and kip, and what the campaign says of it.

    `names` are the columns' names, which carry the units; the numbers are written as they are.
    """

    id: str
    table: pd.DataFrame
    actuation: str
    names: dict[str, str]

    def changed(self, **columns: np.ndarray) -> Planned:
        """The test with other numbers in its columns."""
        return replace(self, table=self.table.assign(**columns))


def load_session(source: Path, session: str) -> list[Planned]:
    """Harmonic tests of a session; ids say the tension and nothing of the motion."""
    with (source / "manifest.csv").open(newline="", encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["session"] == session]
    found: list[Planned] = []
    for row in rows:
        if (
            row["kind"] != "harmonic"
            or row["file"].endswith("_SI.csv")
            or row["tension_lbf"] == "0"
        ):
            continue
        table = pd.read_csv(source / row["file"])
        plain = pd.DataFrame(
            {
                "time": table["time_s"],
                "displacement": table["displacement_in"],
                "force": table["force_kip"],
            }
        )
        letter = chr(ord("a") + sum(t.id.startswith(f"{row['tension_lbf']}lb") for t in found))
        name = f"{row['tension_lbf']}lb_{letter}"
        found.append(Planned(name, plain, f"{row['tension_lbf']} lbf", NAMES))
    return found


def write_session(tests: list[Planned], folder: Path, title: str) -> Path:
    """Write the files and the campaign file of tests; its path."""
    folder.mkdir(parents=True, exist_ok=True)
    text = HEADER.format(title=title)
    for test in tests:
        heads = {"time": "time_s", **test.names}
        table = test.table[["time", "displacement", "force"]].rename(columns=heads)
        table.to_csv(folder / f"{test.id}.csv", index=False, float_format="%.9g")
        text += TEST.format(id=test.id, actuation=test.actuation, **test.names)
    path = folder / "campaign.toml"
    path.write_text(text, encoding="utf-8")
    return path
