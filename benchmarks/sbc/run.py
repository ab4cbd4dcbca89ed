"""Simulation-based calibration: whether posteriors of one test are right on average.

    python -m benchmarks.sbc.run --tests 300 --control 100 --jobs 2 --seed 1

writes sbc.txt (a table) and sbc.png (a picture) beside this file.

A test is a synthetic record. Every parameter, the start in the gap, the offset and the noise are
drawn from a prior that is narrowed to sensible loops; the model and Ornstein–Uhlenbeck noise give
the force; then the posterior under the same prior is sampled. If all is right, the rank of the
true value among L nearly independent draws is uniform over 0 … L, whatever the prior (Talts et
al. 2018). The same holds for the log likelihood (Modrák et al. 2023), which reacts to faults that
no single parameter shows.

Ranks are judged by a band that holds the whole ECDF at once (Säilynoja, Bürkner and Vehtari 2022,
adjusted by simulation), with Bonferroni's correction for the number of quantities. The negative
control samples the first records of the same series with a wrong likelihood, noise without
correlation, and has to fail.

Every finished test is a file in --work, so an interrupted run goes on where it stopped. Files made
by other code or other settings are not used. No test is dropped: a test that stops at the limit of
steps is ranked and counted like all others, and a test that cannot be sampled fails the run.
Exit status 1: ranks are not uniform, a test has no draws, or the control passes.
"""

from __future__ import annotations

import os

# Read when numpy is imported, here and in the processes that this file starts.
os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", MKL_NUM_THREADS="1")

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from benchmarks.common.machine import platform_line
from benchmarks.common.series import fingerprint, run_series
from tests.statistical import sbc_study
from tests.statistical.sbc_study import TRUE, WRONG, Ranked, Study
from tests.statistical.uniformity import LEVEL, Uniformity, failures, rank_cells

LEGEND = """\
p       of the simultaneous ECDF test of one quantity
z       mean rank less the uniform one, in standard errors
spread  sd of the ranks over the uniform one's: above 1 the posteriors are too narrow
worst   largest deviation of the ranks' ECDF from the uniform one"""

REACH = 0.35  # of the picture: the control's log likelihood goes far beyond


def main() -> int:
    options = read_options()
    study = sbc_study.full_study(options.seed, options.model)
    passed = []
    blocks, pictures = [], []
    for noise, count in ((TRUE, options.tests), (WRONG, options.control)):
        tests = run_tests(study, noise, count, options.work, options.jobs)
        ranks = sbc_study.ranks_by_quantity(tests)
        uniformity = Uniformity(len(tests) - sum(bool(t.error) for t in tests), study.draws)
        failed = failures(ranks, uniformity)
        fine = not failed and not any(test.error for test in tests)
        passed.append(fine if noise == TRUE else bool(failed))
        blocks.append(table(noise, tests, ranks, uniformity, study))
        pictures.append((noise, ranks, uniformity))
    command = " ".join(["python -m benchmarks.sbc.run", *sys.argv[1:]])
    place = platform_line()
    text = "\n\n".join([f"{command}\n{place}", LEGEND, *blocks]) + "\n"
    options.out.mkdir(parents=True, exist_ok=True)
    name = "sbc" if options.model == "three_stage" else f"sbc_{options.model}"
    (options.out / f"{name}.txt").write_text(text, encoding="utf-8")
    draw(pictures, options.out / f"{name}.png")
    print(text, end="")
    return 0 if all(passed) else 1


def read_options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="Simulation-based calibration.")
    parser.add_argument("--tests", type=int, default=300)
    parser.add_argument("--control", type=int, default=100, help="tests of the wrong likelihood")
    parser.add_argument("--jobs", type=int, default=2, help="processes, of one thread each")
    parser.add_argument("--seed", type=int, default=1)
    words = "three_stage or backlash; sbc_backlash.txt and .png are that one's"
    parser.add_argument("--model", default="three_stage", help=words)
    parser.add_argument("--work", type=Path, default=Path("out_sbc"), help="finished tests")
    parser.add_argument("--out", type=Path, default=Path(__file__).parent, help="table, picture")
    return parser.parse_args()


def run_tests(study: Study, noise: str, count: int, work: Path, jobs: int) -> list[Ranked]:
    """Results of tests 0 to `count`; those of an earlier run are read from `work`."""
    settings = (dict(study.priors.parameters), study.effort, study.draws, study.seed, study.model)
    motion = study.motion.displacement.tobytes()
    rooms = ("records", "friction", "calibration")
    folder = work / fingerprint(settings, motion, str(sbc_study.__file__), rooms) / noise
    tasks = [
        (folder / f"{i}.json", run_test, (study.seed, i, noise, study.model)) for i in range(count)
    ]
    return [Ranked(**found) for found in run_series(tasks, jobs, f"tests with {noise} noise")]


def run_test(seed: int, index: int, noise: str, model: str) -> dict[str, object]:
    """Ranks of one test, as they are stored."""
    return vars(sbc_study.run_test(sbc_study.full_study(seed, model), index, noise))


def table(
    noise: str,
    tests: Sequence[Ranked],
    ranks: Mapping[str, Sequence[int]],
    uniformity: Uniformity,
    study: Study,
) -> str:
    """Verdict on a series of tests, quantity by quantity."""
    ranked = [test for test in tests if not test.error]
    failed = failures(ranks, uniformity)
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
    for name, values in ranks.items():
        worst = np.max(np.abs(uniformity.deviation(values)))
        lines.append(
            f"{name:20s}{rank_cells(values, uniformity)}"
            f"{worst:9.3f}{'  fails' if name in failed else ''}"
        )
    return "\n".join(lines)


def draw(
    pictures: Sequence[tuple[str, Mapping[str, Sequence[int]], Uniformity]], path: Path
) -> None:
    """Write the ECDF differences of every quantity, with the bands."""
    from mfd_bayes.reporting.colours import BLUE, VERMILLION
    from mfd_bayes.reporting.figures.style import new_figure, style, to_png
    from mfd_bayes.reporting.symbols import Symbols
    from mfd_bayes.store.files import write_bytes

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
                axis.set_title(Symbols().in_figure(name), fontsize=9)
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
    write_bytes(path, to_png(figure))


if __name__ == "__main__":
    sys.exit(main())
