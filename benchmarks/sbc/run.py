"""Simulation-based calibration: whether posteriors rank truths drawn from their prior evenly.

    python benchmarks/sbc.py --tests 300 --control 100 --jobs 2 --seed 1

writes benchmarks/sbc.txt (a table) and benchmarks/sbc.png (a picture). A test is a synthetic
record: every parameter, the place in the gap, the offset and the noise are drawn from a prior
narrowed to sensible loops, the model and Ornstein–Uhlenbeck noise make the force, and the
posterior under that very prior is sampled. If all is right, the rank of the truth among L nearly
independent draws is uniform over 0 … L, whatever the prior (Talts et al. 2018), and so is that of
the log likelihood (Modrák et al. 2023), which sees what single parameters do not.

Uniformity is judged by the band that the whole ECDF of the ranks stays within at once (Säilynoja,
Bürkner and Vehtari 2022, adjusted by simulation), familywise over all quantities by Bonferroni.
The negative control samples the first records of the same series with a wrong likelihood, noise
without correlation, and has to fail.

Every finished test is a file in --work, so an interrupted run goes on where it stopped; tests
that other code or other settings made are not taken. No test is dropped: those that stop at the
limit of steps are ranked like all others and counted, and one that cannot be sampled at all fails
the run. Exit status 1: not uniform, a test without draws, or a control that passes.
"""

from __future__ import annotations

import os

# Read when numpy is imported, here and in the processes that this file starts.
os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", MKL_NUM_THREADS="1")

import argparse
import hashlib
import json
import multiprocessing
import platform
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import sbc_study
from sbc_study import LEVEL, TRUE, WRONG, Ranked, Study, Uniformity

import mfd_bayes

LEGEND = """\
p       of the simultaneous ECDF test of one quantity
z       mean rank less the uniform one, in standard errors
spread  sd of the ranks over the uniform one's: above 1 the posteriors are too narrow
worst   largest deviation of the ranks' ECDF from the uniform one"""

REACH = 0.35  # of the picture: the control's log likelihood goes far beyond


def main() -> int:
    options = read_options()
    study = sbc_study.full_study(options.seed)
    work = options.work / fingerprint(study)
    passed = []
    blocks, pictures = [], []
    for noise, count in ((TRUE, options.tests), (WRONG, options.control)):
        tests = run_tests(study, noise, count, work, options.jobs)
        ranks = sbc_study.ranks_by_quantity(tests)
        uniformity = Uniformity(len(tests) - sum(bool(t.error) for t in tests), study.draws)
        failed = sbc_study.failures(ranks, uniformity)
        fine = not failed and not any(test.error for test in tests)
        passed.append(fine if noise == TRUE else bool(failed))
        blocks.append(table(noise, tests, ranks, uniformity, study))
        pictures.append((noise, ranks, uniformity))
    command = " ".join(["python benchmarks/sbc.py", *sys.argv[1:]])
    place = f"{platform.platform()}, Python {platform.python_version()}"
    text = "\n\n".join([f"{command}\n{place}", LEGEND, *blocks]) + "\n"
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "sbc.txt").write_text(text, encoding="utf-8")
    draw(pictures, options.out / "sbc.png")
    print(text, end="")
    return 0 if all(passed) else 1


def read_options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="Simulation-based calibration.")
    parser.add_argument("--tests", type=int, default=300)
    parser.add_argument("--control", type=int, default=100, help="tests of the wrong likelihood")
    parser.add_argument("--jobs", type=int, default=2, help="processes, of one thread each")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--work", type=Path, default=Path("out_sbc"), help="finished tests")
    parser.add_argument("--out", type=Path, default=Path(__file__).parent, help="table, picture")
    return parser.parse_args()


def fingerprint(study: Study) -> str:
    """Short hash of the settings, and of the code that the tests depend on."""
    settings = (dict(study.priors.parameters), study.effort, study.draws, study.seed)
    digest = hashlib.sha256(repr(settings).encode())
    digest.update(study.motion.displacement.tobytes())
    package = Path(mfd_bayes.__file__).parent
    files = [Path(sbc_study.__file__)]
    for room in ("records", "friction", "calibration"):
        files += sorted((package / room).glob("*.py"))
    for path in files:
        digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


def run_tests(study: Study, noise: str, count: int, work: Path, jobs: int) -> list[Ranked]:
    """Tests 0 to `count`, those of an earlier run read from `work`."""
    folder = work / noise
    folder.mkdir(parents=True, exist_ok=True)
    files = [folder / f"{index}.json" for index in range(count)]
    left = [(study.seed, index, noise, files[index]) for index in range(count)]
    left = [task for task in left if not task[3].is_file()]
    print(f"{noise}: {count - len(left)} of {count} tests found in {folder}", file=sys.stderr)
    began = time.perf_counter()
    with multiprocessing.get_context("spawn").Pool(jobs) as pool:
        for done, _ in enumerate(pool.imap_unordered(_run_and_store, left), 1):
            minutes = (time.perf_counter() - began) / 60.0
            print(f"{noise}: {done} of {len(left)}, {minutes:.1f} min", file=sys.stderr)
    return [Ranked(**json.loads(path.read_text(encoding="utf-8"))) for path in files]


def _run_and_store(task: tuple[int, int, str, Path]) -> None:
    seed, index, noise, path = task
    ranked = sbc_study.run_test(sbc_study.full_study(seed), index, noise)
    beside = path.with_suffix(".part")
    beside.write_text(json.dumps(vars(ranked)), encoding="utf-8")
    beside.replace(path)


def table(
    noise: str,
    tests: Sequence[Ranked],
    ranks: Mapping[str, Sequence[int]],
    uniformity: Uniformity,
    study: Study,
) -> str:
    """Verdict on a series of tests, quantity by quantity."""
    ranked = [test for test in tests if not test.error]
    failed = sbc_study.failures(ranks, uniformity)
    short = sum(not test.converged for test in ranked)
    seconds = np.array([test.seconds for test in ranked])
    purpose = "the right likelihood" if noise == TRUE else "negative control, a wrong likelihood"
    lines = [
        f"{noise} noise assumed ({purpose}): "
        f"{'NOT uniform' if failed else 'uniform'}, {len(failed)} of {len(ranks)} quantities fail",
        f"{len(tests)} tests, none dropped: {len(ranked)} ranked, {short} of them stopped at the "
        f"limit of steps; {len(tests) - len(ranked)} without draws",
        f"L = {study.draws} draws of each, least ESS {min(t.ess for t in ranked):.0f}, largest "
        f"R-hat {max(t.r_hat for t in ranked):.3f}; {np.median(seconds):.1f} s a test (median), "
        f"{seconds.max():.1f} s the longest, {seconds.sum() / 60:.0f} min in all on one core",
        f"familywise {100 * LEVEL:g} % over {len(ranks)} quantities by Bonferroni: "
        f"p below {LEVEL / len(ranks):.2g} fails",
        "",
        f"{'quantity':20s}{'p':>10}{'z':>8}{'spread':>9}{'worst':>9}",
    ]
    middle, sd = study.draws / 2.0, np.sqrt(((study.draws + 1) ** 2 - 1) / 12.0)
    for name, values in ranks.items():
        z = (np.mean(values) - middle) / sd * np.sqrt(len(values))
        worst = np.max(np.abs(uniformity.deviation(values)))
        lines.append(
            f"{name:20s}{uniformity.p_value(values):10.2g}{z:8.2f}{np.std(values) / sd:9.2f}"
            f"{worst:9.3f}{'  fails' if name in failed else ''}"
        )
    return "\n".join(lines)


def draw(
    pictures: Sequence[tuple[str, Mapping[str, Sequence[int]], Uniformity]], path: Path
) -> None:
    """Write the ECDF differences of every quantity, with the bands."""
    from mfd_bayes.reporting.figures.style import BLUE, VERMILLION, new_figure, save_png, style
    from mfd_bayes.reporting.symbols import in_figure

    names = list(pictures[0][1])
    columns = 6
    rows = -(-len(names) // columns)
    with style():
        figure = new_figure(2.0 * columns, 1.7 * rows + 0.9)
        axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
        for axis in axes.flat[len(names) :]:
            axis.set_axis_off()
        for (noise, ranks, uniformity), colour in zip(pictures, (BLUE, VERMILLION), strict=True):
            lower, upper = uniformity.band(LEVEL / len(ranks))
            label = f"{noise} noise assumed, {uniformity.tests} tests"
            for axis, name in zip(axes.flat, names, strict=False):
                axis.set_title(in_figure(name), fontsize=9)
                axis.fill_between(uniformity.z, lower, upper, color=colour, alpha=0.12)
                if name in ranks:
                    values = uniformity.deviation(ranks[name])
                    axis.plot(uniformity.z, values, color=colour, label=label)
        axes[0, 0].set(xlim=(0, 1), xticks=(0, 0.5, 1), ylim=(-REACH, REACH))
        figure.supxlabel("rank of the truth among the draws, as a share", fontsize=9)
        figure.supylabel(f"ECDF less the uniform one, cut at ±{REACH:g}", fontsize=9)
        handles, labels = axes[0, 0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower right", ncols=2)
        figure.suptitle(
            f"Simulation-based calibration: shaded, where all curves of a colour "
            f"stay in {100 * (1 - LEVEL):g} % of cases"
        )
    save_png(figure, path)


if __name__ == "__main__":
    sys.exit(main())
