"""Values of options, as a person, a script or a mistake gives them: no command ends in a traceback.

The commands are the real ones up to the first draw: sampling and pictures have stand-ins.
"""

from __future__ import annotations

import json
from contextlib import chdir
from functools import cache
from pathlib import Path
from unittest.mock import patch

from typer.testing import CliRunner

from benchmarks.fuzz.mutations import MAGIC, WORDS, Rng
from benchmarks.fuzz.outputs import PNG
from benchmarks.fuzz.seeds import priors, texts
from mfd_bayes.cli.commands import app
from mfd_bayes.errors import FitError, MfdError
from mfd_bayes.jobs.local import Workplace, check_workers
from mfd_bayes.pipeline import predict as prediction
from mfd_bayes.population.bands import Forecast, Predictor
from mfd_bayes.runs.run import Run, open_run

_PREDICT = ("predict", "out", "--motion", "a.csv", "--actuation", "500 psi", "-o", "b.csv")
COMMANDS: tuple[tuple[str, ...], ...] = (
    (*_PREDICT, "--kind", "new_test", "--probability", "0.9"),
    (*_PREDICT, "--kind", "this_test", "--test", "a", "--quiet"),
    (*_PREDICT, "--kind", "observation", "--compare", "--whole"),
    ("calibrate", "campaign.toml", "-o", "new", "--effort", "quick", "--seed", "1", "--jobs", "1"),
    ("calibrate", "campaign.toml", "-o", "new", "--scheduler", "tcp://127.0.0.1:1"),
    ("crossvalidate", "campaign.toml", "-o", "new", "--by", "level", "--jobs", "1"),
    ("compare", "campaign.toml", "-o", "new", "--models", "lugre,bouc_wen", "--by", "test"),
    ("inspect", "a.csv", "-o", "looks"),
    ("report", "out", "--quiet"),
    (
        "next",
        "out",
        "--goal",
        "band",
        "--candidates",
        "500 psi",
        "--limits",
        "9 in",
        "--draws",
        "200",
    ),
    ("check", "out", "--all"),
)
CAMPAIGN = "".join(
    f'[[test]]\nid = "{name}"\nfile = "a.csv"\nactuation = "{level} psi"\n'
    for name, level in (("a", 500), ("b", 900))
)
VALUES = (
    *(
        "",
        " ",
        "0",
        "1",
        "-1",
        "1e300",
        "1e-300",
        "nan",
        "inf",
        "-inf",
        "0.9999999999999999",
        "1.0",
    ),
    *(
        "500 psi",
        "1,000 psi",
        "1 Pa",
        "1e12 psi",
        "0 psi",
        "-5 psi",
        "5 lbf",
        "600 rpm",
        "1e-320 psi",
    ),
    *("--", "-o", "--force", "--resume", "test", "session", "lugre", "lugre,lugre", ",", "a", "c"),
    *("out", "a.csv", "campaign.toml", "own.toml", "out/manifest.json", ".", "none", "b.png"),
    *(
        "é",
        "１２",
        "\u202e",
        "a b",
        "$HOME",
        "~",
        "x" * 300,
        "9" * 5000,
        "%s",
        "{}",
        "[red]",
        "\x1b[2J",
    ),
    *("tcp://", "tcp://nowhere", "http://127.0.0.1:1", "udp://x:1", "127.0.0.1:1"),
)


def seed() -> bytes:
    """A command that works."""
    return json.dumps(COMMANDS[0]).encode()


def mutate_command(_: bytes, rng: Rng) -> bytes:
    """A command with some words changed, left out, doubled or added."""
    words = list(COMMANDS[rng.integers(len(COMMANDS))])
    for _turn in range(int(rng.choice([0, 1, 1, 1, 2, 3]))):
        at = int(rng.integers(1, len(words)))
        kind = rng.random()
        if kind < 0.7:
            words[at] = _value(words[at], rng)
        elif kind < 0.8 and len(words) > 2:
            del words[at]
        elif kind < 0.9:
            words.insert(at, words[int(rng.integers(len(words)))])
        else:
            words.insert(at, _value("1", rng))
    return json.dumps([_inside(word) for word in words]).encode()


def _inside(word: str) -> str:
    """A word that names nothing outside of the folder, for these commands do write."""
    known = word in VALUES or any(word in command for command in COMMANDS)
    return word if known else word.replace("/", "").replace("..", "")


def _value(word: str, rng: Rng) -> str:
    kind = rng.random()
    if kind < 0.6:
        return VALUES[rng.integers(len(VALUES))]
    if kind < 0.8:
        at = int(rng.integers(len(word) + 1))
        return word[:at] + chr(int(rng.integers(32, 127))) + word[at + int(rng.integers(2)) :]
    if kind < 0.9:
        return str(MAGIC[rng.integers(len(MAGIC))])
    found = WORDS[rng.integers(len(WORDS))]
    text = found.decode("utf-8", "replace") if isinstance(found, bytes) else str(found)
    return text.replace("\0", "")


def files_of_command(run: dict[str, bytes]) -> dict[str, bytes]:
    """A folder with a run, a campaign, its record and a command."""
    named = {f"out/{name}": content for name, content in run.items()}
    own = {"campaign.toml": CAMPAIGN.encode(), "a.csv": texts()[0], "own.toml": priors()}
    return named | own | {"command.json": seed()}


@cache
def _opened(manifest: bytes, home: Path) -> Run:
    """The run, which no command changes: a worker lays all out in one place."""
    return open_run(home / "out")


def _open(folder: str | Path) -> Run:
    folder = Path(folder)
    if folder.resolve() != Path("out").resolve():
        return open_run(folder)
    return _opened(Path("out/manifest.json").read_bytes(), Path.cwd())


def _few(real: object) -> object:
    def predict(self: Predictor, trace: object, forecast: Forecast, *own: object) -> object:
        object.__setattr__(forecast, "draws", 10)
        return real(self, trace, forecast, *own)  # type: ignore[operator]

    return predict


def _stop(*_: object, **__: object) -> None:
    raise FitError("as far as the first draw")


def read_command(path: Path) -> object:
    """Run a command in its folder: a result, or one sentence; 0, 1 or 2, and no traceback."""
    words = json.loads(path.read_text())
    stand_ins = (
        patch.object(prediction, "open_run", _open),
        patch.object(Predictor, "predict", _few(Predictor.predict)),
        patch.object(Predictor, "repeat", _few(Predictor.repeat)),
        *(patch(f"mfd_bayes.pipeline.{m}.calibrate_locked", _stop) for m in _CALIBRATE),
        *(patch(f"mfd_bayes.{m}.get_ready", _nothing) for m in _STARTS_A_SERVER),
        patch("mfd_bayes.pipeline.report.write_report", _stop),
        patch("mfd_bayes.pipeline.report.assess", _stop),
        patch("mfd_bayes.pipeline.calibrate.check_workers", _no_cluster),
        *(patch(f"mfd_bayes.reporting.figures.{name}", lambda *_, **__: PNG) for name in _FIGURES),
    )
    with chdir(path.parent):
        for each in stand_ins:
            each.start()
        try:
            done = CliRunner().invoke(app, words, prog_name="mfd-bayes")
        finally:
            for each in stand_ins:
                each.stop()
    return _judged(done)


def _nothing(*_: str) -> None:
    """In the place of what no input needs."""


def _no_cluster(options: Workplace) -> None:
    if options.scheduler:
        raise FitError("no cluster is asked here")
    check_workers(options)


_STARTS_A_SERVER = ("jobs.local", "pipeline.calibrate", "pipeline.report")
"""Modules that start a server of processes, which would outlive the folder."""
_CALIBRATE = ("calibrate", "crossvalidate", "compare")
_FIGURES = ("to_png", "draw_loops", "draw_history", "draw_inspection")


_BOXES = ("Usage", "╭─ Error")
"""How the parser of the command line begins what it refuses."""


def _judged(done: object) -> object:
    error, code = done.exception, done.exit_code  # type: ignore[attr-defined]
    if error is not None and not isinstance(error, SystemExit):
        raise error
    if code == 2:
        said = done.stderr.strip()  # type: ignore[attr-defined]
        lines = said.splitlines()
        if not said or (not said.startswith(_BOXES) and not lines[-1].startswith("mfd-bayes: ")):
            raise AssertionError(f"no sentence: {said[:200]!r}")
        raise MfdError(lines[-1] if not said.startswith(_BOXES) else "a wrong call")
    if code not in (0, 1):
        raise AssertionError(f"exit code {code}")
    return code
