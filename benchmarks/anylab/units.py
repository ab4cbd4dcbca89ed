"""The same campaign in kip and in, and in N and mm: the same draws to rounding, the same report.

    python -m benchmarks.anylab.units

prints the largest difference between the draws of both, by their spread; then, with both reports in
N and mm, how many words and figures of each output differ: of the page, of all tables as CSV, JSON
and LaTeX, and of what `check` prints. What must differ is left out: the units of the files' own
columns, hashes, dates and times of computation. A figure differs where it is off by more than two
units of its last digit, or 1e-5 of its size.
"""

import html
import re
import shutil
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.anylab.run import command
from mfd_bayes.runs.run import open_run
from mfd_bayes.units import factor
from tests.pipeline.devices import DEVICES, write_device

_NUMBER = re.compile(r"[+-]?\d+(?:\.\d+)?(?:e[+-]?\d+)?")
_OWN = (
    r"data:[\w/;,+=.-]+|<(?:script|style|svg)\b.*?</(?:script|style|svg)>",  # pictures
    r"(?<= )\[(?:in|mm|kip|N)\]",  # of a file's column
    r"\b[0-9a-f]{8,64}\b|\d{4}-\d\d-\d\d[T ][\d:.+Z]+",
    r"\d+ (?:min(?: \d+ s)?|s) (?=of computation)",
)


def main() -> None:
    kept = Path(sys.argv[1]) if len(sys.argv) > 1 else None
    with tempfile.TemporaryDirectory() as name:
        home = Path(name)
        make(home)
        print(f"largest difference of a draw, in its standard deviations: {draws_apart(home):.2g}")
        compare(home)
        if kept is not None:
            shutil.copytree(home, kept, dirs_exist_ok=True)


def make(home: Path) -> None:
    """Two runs of one campaign, in `N` and in `kip`, both with reports in N and mm."""
    metric, customary = home / "N" / "seal", home / "kip" / "seal"
    metric.mkdir(parents=True)
    customary.mkdir(parents=True)
    write_device(metric, DEVICES[0])
    by = [1.0, factor("mm", "displacement"), factor("N", "force")]
    for path in sorted(metric.glob("*.txt"))[:2]:
        path.unlink()
    for path in metric.glob("*.txt"):
        rows = np.loadtxt(path, skiprows=2) * by
        np.savetxt(customary / path.name, rows, "%.17g", "\t", header="two\nlines", comments="")
    campaign_of(metric, "mm", "N")
    campaign_of(customary, "in", "kip")
    command([str(metric / "campaign.toml")], "init")
    shutil.copy(metric / "priors.toml", customary)
    for folder in (metric, customary):
        out = str(folder.parent / "out")
        options = ["-o", out, "--effort", "quick", "--jobs", "1"]
        command([str(folder / "campaign.toml"), *options], "calibrate")
        command([out, "--units", "si"], "report")
        told = command([out, "--units", "si"], "check", may_fail=True)
        (folder.parent / "out" / "check.txt").write_text(told, encoding="utf-8")


def campaign_of(folder: Path, length: str, force: str) -> None:
    lines = ['[campaign]\npriors = "priors.toml"\n[columns]\ntime = { column = 1, unit = "s" }']
    lines += [f'displacement = {{ column = 2, unit = "{length}" }}']
    lines += [f'force = {{ column = 3, unit = "{force}" }}']
    for path in sorted(folder.glob("*.txt")):
        bar = path.stem.split("bar")[0]
        test = f'[[test]]\nid = "{path.stem}"\nfile = "{path.name}"\nactuation = "{bar} bar"'
        lines.append(test)
    (folder / "campaign.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")


def draws_apart(home: Path) -> float:
    """Largest difference of a draw of both runs, in its standard deviations."""
    runs = {unit: open_run(home / unit / "out") for unit in ("N", "kip")}
    worst = 0.0
    for name, test in runs["N"].tests.items():
        for quantity, drawn in test.draws.data_vars.items():
            other = runs["kip"].tests[name].draws[quantity].to_numpy()
            spread = float(np.std(drawn.to_numpy())) or 1.0
            worst = max(worst, float(np.max(np.abs(drawn.to_numpy() - other))) / spread)
    return worst


def compare(home: Path) -> None:
    """Print how each output of one run differs from the other's."""
    names = [
        path.name
        for path in sorted((home / "N" / "out").iterdir())
        if path.suffix in (".html", ".csv", ".json", ".tex", ".txt") and path.stem != "manifest"
    ]
    others = {path.name for path in (home / "kip" / "out").iterdir()}
    print(f"\n{'output':24s}{'figures':>9s}{'differ':>8s}{'words':>8s}{'differ':>8s}")
    for name in names:
        if name not in others:
            print(f"{name:24s} only of N and mm")
            continue
        texts = [words_of(home / unit / "out" / name) for unit in ("N", "kip")]
        figures, words = ([pick(text) for text in texts] for pick in (figures_in, words_in))
        wrong = list(unequal(*figures))
        others_said = [pair for pair in zip(*words, strict=False) if pair[0] != pair[1]]
        longer = abs(len(words[0]) - len(words[1]))
        print(f"{name:24s}{len(figures[0]):9d}{len(wrong):8d}{len(words[0]):8d}"
              f"{len(others_said) + longer:8d}")  # fmt: skip
        for one, other in (*wrong[:5], *others_said[:5]):
            print(f"    {one} | {other}")


def words_of(path: Path) -> str:
    """Text of an output without its pictures, its markup and what must differ."""
    text = path.read_text(encoding="utf-8")
    for pattern in _OWN:
        text = re.sub(pattern, " ", text, flags=re.DOTALL)
    if path.suffix == ".html":
        text = html.unescape(re.sub(r"<[^>]*>", " ", text))
    return text.replace("−", "-")


def figures_in(text: str) -> list[str]:
    return _NUMBER.findall(text)


def words_in(text: str) -> list[str]:
    return _NUMBER.sub("#", text).split()


def unequal(one: list[str], other: list[str]) -> Iterator[tuple[str, str]]:
    """Pairs of figures that differ by more than their last digits allow."""
    if len(one) != len(other):
        yield f"{len(one)} figures", f"{len(other)} figures"
        return
    for a, b in zip(one, other, strict=True):
        allowed = max(2.0 * _last_digit(a), 2.0 * _last_digit(b), 1e-5 * abs(float(a)))
        if not abs(float(a) - float(b)) <= allowed:
            yield a, b


def _last_digit(number: str) -> float:
    """Size of a unit of a number's last digit."""
    mantissa, _, power = number.partition("e")
    decimals = len(mantissa.partition(".")[2])
    return 10.0 ** (int(power or 0) - decimals) if decimals else 0.0


if __name__ == "__main__":
    main()
