"""Is a mistake that was planted into a real session named, with its right cause?

    python -m benchmarks.mistakes.run > benchmarks/mistakes/mistakes.txt

takes some minutes (--quick: three mistakes; --only WORDS: those). Plants each mistake of plants.py
into three places of real sessions of the band brake, one at a time, and reads what `calibrate
--dry-run` says (`inspect`, `calibrate` and `check` say the same): under names that tell the tension
(35lb_a), and under neutral ones (id t20, file r20.csv). Then the real records as they are: every
warning about a record is a false alarm; those about the laws, such as of tests without tension, are
not counted. Exit status 1: fewer than NAMED mistakes are named in all three places, or there is a
false alarm. --say prints every warning. Real records come from --data.
"""

from benchmarks import common  # isort: skip  (one thread, before numpy)

import multiprocessing
import re
import tempfile
from collections import Counter
from itertools import groupby, product
from pathlib import Path

import pandas as pd

from benchmarks.mistakes.plants import MISTAKES, Planned, neutral, plant
from mfd_bayes.errors import MfdError
from mfd_bayes.pipeline.options import RunOptions
from mfd_bayes.pipeline.plan import plan_campaign

NAMED = {"own": 36, "neutral": 32}  # least number of mistakes that are named in every place
PLACES = (("2022-07", 3), ("2022-07", 7), ("2023-04", 4))
NAMES = {"displacement": "displacement_in", "force": "force_kip"}
HEADER = """\
[campaign]
title = "{title}"
priors = "brfd"
"""
TEST = """
[[test]]
id = "{id}"
file = "{file}.csv"
actuation = "{actuation}"
columns = {{ time = {{ name = "time_s", unit = "s" }}, \
displacement = {{ name = "{displacement}" }}, force = {{ name = "{force}" }} }}
"""


def load_session(source: Path, session: str) -> list[Planned]:
    """Harmonic tests of a session; ids say the tension and nothing of the motion."""
    tests: list[Planned] = []
    for row in common.listed(source):
        pounds = row["tension_lbf"]
        if row["session"] != session or row["kind"] != "harmonic" or pounds == "0":
            continue
        if row["id"].endswith("_SI"):
            continue
        table = pd.read_csv(source / "brfd" / row["file"])
        table = table.rename(columns={"time_s": "time"} | {v: k for k, v in NAMES.items()})
        letter = chr(ord("a") + sum(t.id.startswith(f"{pounds}lb") for t in tests))
        columns = table[["time", "displacement", "force"]]
        tests.append(Planned(f"{pounds}lb_{letter}", columns, float(pounds), NAMES))
    return tests


def write_session(tests: list[Planned], folder: Path, title: str) -> Path:
    """Write the files and the campaign file of tests; its path."""
    folder.mkdir(parents=True, exist_ok=True)
    text = HEADER.format(title=title)
    for test in tests:
        table = test.table[["time", "displacement", "force"]]
        table = table.rename(columns={"time": "time_s", **test.names})
        stem = test.stem or test.id
        table.to_csv(folder / f"{stem}.csv", index=False, float_format="%.9g")
        actuation = f"{test.level:g} {test.unit}"
        text += TEST.format(id=test.id, file=stem, actuation=actuation, **test.names)
    path = folder / "campaign.toml"
    path.write_text(text, encoding="utf-8")
    return path


Said = list[tuple[str, str]]


def said_by(campaign: Path) -> Said:
    """Warnings of the dry run, by test; a refusal is of none."""
    try:
        plan = plan_campaign(campaign, RunOptions(effort="quick"))
    except MfdError as error:
        return [("", str(error))]
    return [(warning.subject, str(warning.message)) for warning in plan.manifest.warnings]


def named(remarks: Said, test: str, cause: str) -> bool:
    """Whether a sentence about the test, or that has its id, tells the cause."""
    word = rf"\b{re.escape(test)}\b"
    return any(
        (subject == test or re.search(word, sentence)) and re.search(cause, sentence)
        for subject, sentence in remarks
    )


def try_out(case: tuple[Path, str, str, tuple[str, int]]) -> tuple[bool, Said]:
    """Whether a mistake in a place is named, under names "own" or "neutral", and all warnings."""
    source, mistake, names, (session, k) = case
    tests, wrong = plant(mistake, load_session(source, session), k)
    if names == "neutral":
        renamed = neutral(tests)
        tests, wrong = [*renamed.values()], [renamed[test].id for test in wrong]
    with tempfile.TemporaryDirectory() as folder:
        remarks = said_by(write_session(tests, Path(folder), mistake))
    return all(named(remarks, test, MISTAKES[mistake][0]) for test in wrong), remarks


def false_alarms(source: Path) -> Said:
    """Every warning about the real records as they are: every session, and halves of two."""
    remarks: Said = []
    for session in sorted({row["session"] for row in common.listed(source)}):
        with tempfile.TemporaryDirectory() as folder:
            remarks += said_by(common.lay_out(source, Path(folder) / session, session))
    for session in ("2022-07", "2023-04"):
        tests = [*neutral(load_session(source, session)).values()]
        for subset in (tests, tests[::2], tests[1::2]):
            with tempfile.TemporaryDirectory() as folder:
                remarks += said_by(write_session(subset, Path(folder), session))
    return [warning for warning in remarks if warning[0] != "laws"]


def main() -> None:
    parser = common.parser_of(__doc__ or "", data=True, jobs=2)
    parser.add_argument("--say", action="store_true", help="print what the dry run says, too")
    parser.add_argument("--only", default="", help="only mistakes whose name has these words")
    options = common.begin(parser)
    planted = [mistake for mistake in MISTAKES if options.only in mistake]
    planted, complete = planted[: 3 if options.quick else None], Counter[str]()
    cases = [(options.data, *c) for c in product(planted, NAMED, PLACES)]
    print(f"{'mistake':32s}" + "".join(f"{names:>10s}" for names in NAMED))
    with multiprocessing.get_context("spawn").Pool(options.jobs) as pool:
        results = zip(cases, pool.imap(try_out, cases), strict=True)
        alarms = pool.apply_async(false_alarms, (options.data,)) if planted == [*MISTAKES] else None
        for mistake, of_mistake in groupby(results, key=lambda result: result[0][1]):
            counts: Counter[str] = Counter()
            for (_, _, names, position), (hit, remarks) in of_mistake:
                counts[names] += hit
                for subject, sentence in remarks if options.say else ():
                    print(f"    {mistake}, {names}, {position}: {subject}: {sentence}")
            cells = "".join(f"{counts[names]:>8d}/{len(PLACES)}" for names in NAMED)
            print(f"{mistake:32s}{cells}", flush=True)
            complete.update(names for names in NAMED if counts[names] == len(PLACES))
        remarks = [] if alarms is None else alarms.get()
    print(f"{'named in every place':32s}" + "".join(f"{complete[names]:>10d}" for names in NAMED))
    print("".join(f"false alarm: {subject}: {sentence}\n" for subject, sentence in remarks), end="")
    failed = [f"{len(remarks)} false alarms"] if remarks else []
    failed += [
        f"{complete[names]} of {len(planted)} are named under {names} names, not {minimum}"
        for names, minimum in NAMED.items()
        if complete[names] < minimum and alarms is not None
    ]
    print(f"{len(remarks)} false alarms on {len(common.listed(options.data))} real records")
    common.finish(failed)


if __name__ == "__main__":
    main()
