"""Which command names a mistake that was planted into a real session, and its right cause?

    python -m benchmarks.mistakes.run > benchmarks/mistakes/mistakes.txt

takes ten minutes (--quick: three mistakes). Plants each mistake of plants.py into three tests of
real sessions of the band brake, one at a time, and reads what `init`, `inspect` and `calibrate
--dry-run` say (`calibrate` and `check` say what the dry run does). Then the real records as they
are, in their sessions: every warning about a record is a false alarm; those about the laws, such as
of tests without tension, are not counted. Exit status 1: fewer than NAMED mistakes are named in all
three places, or there is a false alarm. --say prints every warning. Real records come from --data.
"""

from benchmarks import common  # isort: skip  (one thread, before numpy)

import re
import tempfile
from collections import Counter
from pathlib import Path

import pandas as pd

from benchmarks.mistakes.plants import MISTAKES, Planned, plant
from mfd_bayes.campaign.draft import draft_campaign
from mfd_bayes.errors import MfdError
from mfd_bayes.pipeline.plan import Options, inspect_campaign, plan_campaign

NAMED = 27
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
file = "{id}.csv"
actuation = "{actuation}"
columns = {{ time = {{ name = "time_s", unit = "s" }}, \
displacement = {{ name = "{displacement}" }}, force = {{ name = "{force}" }} }}
"""


def load_session(source: Path, session: str) -> list[Planned]:
    """Harmonic tests of a session; ids say the tension and nothing of the motion."""
    found: list[Planned] = []
    for row in common.listed(source):
        pounds = row["tension_lbf"]
        if row["session"] != session or row["kind"] != "harmonic" or pounds == "0":
            continue
        if row["id"].endswith("_SI"):
            continue
        table = pd.read_csv(source / "brfd" / row["file"])
        table = table.rename(columns={"time_s": "time"} | {v: k for k, v in NAMES.items()})
        letter = chr(ord("a") + sum(t.id.startswith(f"{pounds}lb") for t in found))
        columns = table[["time", "displacement", "force"]]
        found.append(Planned(f"{pounds}lb_{letter}", columns, float(pounds), NAMES))
    return found


def write_session(tests: list[Planned], folder: Path, title: str) -> Path:
    """Write the files and the campaign file of tests; its path."""
    folder.mkdir(parents=True, exist_ok=True)
    text = HEADER.format(title=title)
    for test in tests:
        table = test.table[["time", "displacement", "force"]]
        table = table.rename(columns={"time": "time_s", **test.names})
        table.to_csv(folder / f"{test.id}.csv", index=False, float_format="%.9g")
        text += TEST.format(id=test.id, actuation=f"{test.level:g} {test.unit}", **test.names)
    path = folder / "campaign.toml"
    path.write_text(text, encoding="utf-8")
    return path


Said = list[tuple[str, str]]


def say_init(campaign: Path) -> Said:
    """Doubts of `init` about a folder, by test."""
    draft = draft_campaign(campaign.parent)
    doubts = [(test.id, doubt) for test in draft.tests for doubt in test.doubts]
    return doubts + [(Path(name).stem, reason) for name, reason in draft.left_out]


def say_inspect(campaign: Path) -> Said:
    """Warnings of `inspect campaign.toml`, by test."""
    tests, _ = inspect_campaign(campaign)
    return [(test.name, str(fault.message)) for test in tests for fault in test.faults]


def say_plan(campaign: Path) -> Said:
    """Warnings of the dry run, which are those of calibrate and check, by test."""
    plan = plan_campaign(campaign, Options(effort="quick"))
    return [(found.subject, str(found.message)) for found in plan.manifest.warnings]


COMMANDS = {"init": say_init, "inspect": say_inspect, "--dry-run": say_plan}


def said_by(command: str, campaign: Path) -> Said:
    """What a command says, by test; a refusal is of none."""
    try:
        return COMMANDS[command](campaign)
    except MfdError as error:
        return [("", str(error))]


def named(said: Said, test: str, cause: str) -> bool:
    """Whether a sentence about the test, or that has its id, tells the cause."""
    return any(
        (subject == test or test in sentence) and re.search(cause, sentence)
        for subject, sentence in said
    )


def false_alarms(source: Path, home: Path) -> list[str]:
    """Every warning about the real records as they are, each by itself and in its session."""
    found: list[str] = []
    for session in sorted({row["session"] for row in common.listed(source)}):
        said = said_by("--dry-run", common.lay_out(source, home / session, session))
        found += [f"{subject}: {sentence}" for subject, sentence in said if subject != "laws"]
    return found


def main() -> None:
    parser = common.parser_of(__doc__ or "", data=True)
    parser.add_argument("--say", action="store_true", help="print what the dry run says, too")
    options = common.begin(parser)
    sessions = {name: load_session(options.data, name) for name in ("2022-07", "2023-04")}
    chosen, whole = list(MISTAKES)[: 3 if options.quick else None], Counter[str]()
    print(f"{'mistake':28s}" + "".join(f"{command:>11s}" for command in COMMANDS))
    with tempfile.TemporaryDirectory() as temporary:
        for number, mistake in enumerate(chosen):
            counts: Counter[str] = Counter()
            for at, (name, k) in enumerate(PLACES):
                tests, test = plant(mistake, sessions[name], k)
                campaign = write_session(tests, Path(temporary) / f"{number}_{at}", mistake)
                for command in COMMANDS:
                    said = said_by(command, campaign)
                    counts[command] += named(said, test, MISTAKES[mistake][0])
                for subject, sentence in said if options.say else ():
                    print(f"    {mistake}, {name} {k}: {subject}: {sentence}")
            cells = "".join(f"{counts[c]:>9d}/{len(PLACES)}" for c in COMMANDS)
            print(f"{mistake:28s}{cells}", flush=True)
            whole.update(c for c in COMMANDS if counts[c] == len(PLACES))
        alarms = [] if options.quick else false_alarms(options.data, Path(temporary))
    print(f"{'named in every place':28s}" + "".join(f"{whole[c]:>11d}" for c in COMMANDS))
    print("".join(f"false alarm: {sentence}\n" for sentence in alarms), end="")
    print(
        f"calibrate names {whole['--dry-run']} of {len(chosen)} (at least {NAMED}), with "
        f"{len(alarms)} false alarms on {len(common.listed(options.data))} real records"
    )
    failed = [f"{len(alarms)} false alarms"] if alarms else []
    if whole["--dry-run"] < NAMED:
        failed.append(f"{whole['--dry-run']} mistakes are named")
    common.finish([] if options.quick else failed)


if __name__ == "__main__":
    main()
