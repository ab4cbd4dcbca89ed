"""The same campaign in kip and in, and in N and mm: the same draws to rounding.

    python -m benchmarks.anylab.units

prints the largest difference between the draws of both, by their spread, and between the figures of
both reports' tables once they are in one system.
"""

import tempfile
from pathlib import Path

import numpy as np
import pandas as pd

from benchmarks.anylab.devices import DEVICES, write_device
from benchmarks.anylab.run import command
from mfd_bayes.runs.opening import open_run
from mfd_bayes.units import factor


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        home = Path(name)
        write_device(home / "N" if (home / "N").mkdir() is None else home, DEVICES[0])
        metric = home / "N"
        for path in sorted(metric.glob("*.txt"))[2:]:
            path.unlink()
        (home / "kip").mkdir()
        for path in metric.glob("*.txt"):
            rows = np.loadtxt(path, skiprows=2)
            by = [1.0, factor("mm", "displacement"), factor("N", "force")]
            np.savetxt(home / "kip" / path.name, rows * by, "%.17g", "\t", header="two\nlines",
                       comments="")  # fmt: skip
        campaign_of(home / "N", "mm", "N")
        campaign_of(home / "kip", "in", "kip")
        priors = home / "N" / "priors.toml"
        command([str(home / "N" / "campaign.toml")], "init")
        (home / "kip" / "priors.toml").write_text(priors.read_text(encoding="utf-8"))
        for unit in ("N", "kip"):
            out = ["-o", str(home / f"{unit}_out"), "--effort", "quick", "--jobs", "1"]
            command([str(home / unit / "campaign.toml"), *out], "calibrate")
            if unit == "kip":
                command([str(home / "kip_out"), "--units", "si"], "report")
        compare(home)


def campaign_of(folder: Path, length: str, force: str) -> None:
    lines = ['[campaign]\npriors = "priors.toml"\n[columns]\ntime = { column = 1, unit = "s" }']
    lines += [f'displacement = {{ column = 2, unit = "{length}" }}']
    lines += [f'force = {{ column = 3, unit = "{force}" }}']
    for path in sorted(folder.glob("*.txt")):
        bar = path.stem.split("bar")[0]
        test = f'[[test]]\nid = "{path.stem}"\nfile = "{path.name}"\nactuation = "{bar} bar"'
        lines.append(test)
    (folder / "campaign.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")


def compare(home: Path) -> None:
    runs = {unit: open_run(home / f"{unit}_out") for unit in ("N", "kip")}
    worst = 0.0
    for name, test in runs["N"].tests.items():
        for quantity, drawn in test.draws.data_vars.items():
            other = runs["kip"].tests[name].draws[quantity].to_numpy()
            spread = float(np.std(drawn.to_numpy())) or 1.0
            worst = max(worst, float(np.max(np.abs(drawn.to_numpy() - other))) / spread)
    print(f"largest difference of a draw, in its standard deviations: {worst:.2g}")
    tables = [pd.read_csv(home / f"{unit}_out" / "parameters.csv") for unit in ("N", "kip")]
    same = list(tables[0]["unit"].fillna("")) == list(tables[1]["unit"].fillna(""))
    medians = [table["q50"] if "q50" in table else table["median"] for table in tables]
    apart = float(np.nanmax(np.abs(medians[0] / medians[1] - 1.0)))
    print(f"parameters.csv in one system: same units {same}, medians differ by at most {apart:.2g}")


if __name__ == "__main__":
    main()
