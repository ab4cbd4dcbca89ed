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

import csv
import re
import tempfile
from collections import Counter
from pathlib import Path

import pandas as pd

from benchmarks.mistakes.plants import MISTAKES, Mistake, Planned
from mfd_bayes.campaign.draft import draft_campaign
from mfd_bayes.errors import MfdError
from mfd_bayes.pipeline.plan import Options, inspect_campaign, plan_campaign

COMMANDS = ("init", "inspect", "--dry-run")
NAMED = 27
PLACES = (("2022-07", 3), ("2022-07", 7), ("2023-04", 4))

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


Said = list[tuple[str, str]]


def say_init(campaign: Path) -> Said:
    """Doubts of `init` about a folder, by test."""
    try:
        draft = draft_campaign(campaign.parent)
    except MfdError as error:
        return [("", str(error))]
    doubts = [(test.id, doubt) for test in draft.tests for doubt in test.doubts]
    return doubts + [(Path(name).stem, reason) for name, reason in draft.left_out]


def say_inspect(campaign: Path) -> Said:
    """Warnings of `inspect campaign.toml`, by test."""
    try:
        found, _ = inspect_campaign(campaign)
    except MfdError as error:
        return [("", str(error))]
    return [(one.name, str(fault.message)) for one in found for fault in one.faults]


def say_plan(campaign: Path) -> Said:
    """Warnings of the dry run, which are those of calibrate and check, by test."""
    try:
        plan = plan_campaign(campaign, Options(effort="quick"))
    except MfdError as error:
        return [("", str(error))]
    return [(found.subject, str(found.message)) for found in plan.manifest.warnings]


def named(said: Said, test: str, cause: str) -> bool:
    """Whether a sentence about the test, or that has its id, tells the cause."""
    return any(
        (subject == test or test in sentence) and re.search(cause, sentence)
        for subject, sentence in said
    )


def plant(mistake: Mistake, session: list[Planned], k: int, home: Path) -> tuple[dict, Said]:
    """Which commands name a mistake in test k, and all that the dry run says."""
    tests, test = mistake.plant(session, k)
    campaign = write_session(tests, home, mistake.name)
    planned = say_plan(campaign)
    said = {"init": say_init(campaign), "inspect": say_inspect(campaign)}
    said["--dry-run"] = planned
    return {c: named(s, test, mistake.cause) for c, s in said.items()}, planned


def false_alarms(source: Path, home: Path) -> list[str]:
    """Every warning about the real records as they are, each by itself and in its session."""
    with (source / "manifest.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    sessions: dict[str, list[dict[str, str]]] = {}
    for row in rows:
        sessions.setdefault(row["session"], []).append(row)
    found: list[str] = []
    for name, members in sessions.items():
        folder = home / name
        folder.mkdir()
        text = HEADER.format(title=name)
        for row in members:
            (folder / row["file"]).write_bytes((source / row["file"]).read_bytes())
            metric = row["file"].endswith("_SI.csv")
            units = ("displacement_m", "force_N") if metric else ("displacement_in", "force_kip")
            text += TEST.format(
                id=row["file"].removesuffix(".csv"),
                actuation=f"{row['tension_lbf'] or 30} lbf",
                displacement=units[0],
                force=units[1],
            )
        campaign = folder / "campaign.toml"
        campaign.write_text(text, encoding="utf-8")
        found += [f"{subject}: {s}" for subject, s in say_plan(campaign) if subject != "laws"]
    return found


def main() -> None:
    parser = common.parser_of(__doc__ or "", data=True)
    parser.add_argument("--say", action="store_true", help="print what the dry run says, too")
    options = parser.parse_args()
    common.heading((__doc__ or "").splitlines()[0])
    source = options.data / "brfd"
    sessions = {name: load_session(source, name) for name in ("2022-07", "2023-04")}
    chosen, whole = (MISTAKES[:3] if options.quick else MISTAKES), Counter[str]()
    print(f"{'mistake':28s}" + "".join(f"{command:>11s}" for command in COMMANDS))
    with tempfile.TemporaryDirectory() as temporary:
        for number, mistake in enumerate(chosen):
            counts: Counter[str] = Counter()
            for at, (name, k) in enumerate(PLACES):
                home = Path(temporary) / f"{number}_{at}"
                hits, said = plant(mistake, sessions[name], k, home)
                counts.update(command for command in COMMANDS if hits[command])
                for subject, sentence in said if options.say else ():
                    print(f"    {mistake.name}, {name} {k}: {subject}: {sentence}")
            cells = "".join(f"{counts[c]:>9d}/{len(PLACES)}" for c in COMMANDS)
            print(f"{mistake.name:28s}{cells}", flush=True)
            whole.update(c for c in COMMANDS if counts[c] == len(PLACES))
        alarms = [] if options.quick else false_alarms(source, Path(temporary))
    print(f"{'named in every place':28s}" + "".join(f"{whole[c]:>11d}" for c in COMMANDS))
    print("".join(f"false alarm: {sentence}\n" for sentence in alarms), end="")
    print(
        f"calibrate names {whole['--dry-run']} of {len(chosen)} (at least {NAMED}), with "
        f"{len(alarms)} false alarms on {sum(1 for _ in source.glob('*.csv')) - 1} real records"
    )
    failed = [f"{len(alarms)} false alarms"] if alarms else []
    if whole["--dry-run"] < NAMED:
        failed.append(f"{whole['--dry-run']} mistakes are named")
    common.finish([] if options.quick else failed)


if __name__ == "__main__":
    main()
