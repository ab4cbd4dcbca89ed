"""Write a campaign folder from the real band-brake records of the 2022 session.

    python -m benchmarks.common.brfd_campaign FOLDER

copies the records from MFD_BAYES_DATA (by default ../shared/data) and writes campaign.toml: all
tests at 0.5 Hz are for calibration, all tests at 1 Hz for validation. Then

    mfd-bayes calibrate FOLDER/campaign.toml -o OUT

The records are under CC BY-SA 4.0 (Coble, Huggins, Cao, Ricles, Downey, 2022): keep them out of
the project.
"""

import csv
import shutil
import sys
from pathlib import Path

from benchmarks.common.data import data_folder

HEADER = """\
[campaign]
title = "Banded rotary friction device, 2022 session"
priors = "brfd"
model = "three_stage"
noise = "ou"

[columns]
time = { name = "time_s", unit = "s" }
displacement = { name = "displacement_in", unit = "in" }
force = { name = "force_kip", unit = "kip" }
"""

TEST = """
[[test]]
id = "{id}"
file = "{file}"
actuation = "{tension} lbf"
role = "{role}"
"""


def lay_out(source: Path, folder: Path, session: str = "2022-07") -> Path:
    """Copy the harmonic records of a session and write their campaign file; its path."""
    folder.mkdir(parents=True, exist_ok=True)
    with (source / "manifest.csv").open(newline="", encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["session"] == session]
    entries = []
    for row in rows:
        shutil.copyfile(source / row["file"], folder / row["file"])
        hertz = float(row["frequency_hz"])
        entries.append(
            TEST.format(
                id=f"{row['tension_lbf']}lb_{hertz:g}Hz",
                file=row["file"],
                tension=row["tension_lbf"],
                role="calibrate" if hertz == 0.5 else "validate",
            )
        )
    campaign = folder / "campaign.toml"
    campaign.write_text(HEADER + "".join(entries), encoding="utf-8")
    return campaign


def main() -> None:
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    print(lay_out(data_folder() / "brfd", Path(sys.argv[1])))


if __name__ == "__main__":
    main()
