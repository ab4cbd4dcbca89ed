"""Outputs that are inputs, files of a run, pipes, devices and links: nothing of these is lost."""

from __future__ import annotations

import json
import os
import stat
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarks.fuzz.mutations import Rng
from mfd_bayes.errors import MfdError
from mfd_bayes.pipeline.outputs import check_outputs
from mfd_bayes.pipeline.predict import Question, check_question
from mfd_bayes.store.files import write_bytes, write_text

PNG = b"\x89PNG\r\n\x1a\n" + b"\0\0\0\rIHDR" + bytes(17) + b"\0\0\0\0IEND" + bytes(4)
BANDS = "# band\ntime_s,displacement_in,lower_kip,median_kip,upper_kip\n0,0,0,0,0\n"
DERIVED = "# derived\nquantity,unit,mean\n"
DESIGN = "# design\nproperty,unit,basis\n"

NAMES = (
    *("b.csv", "b", "new/b.csv", "m.csv", "./m.csv", "sub/../m.csv", "here/m.csv", "m", "m.png"),
    *("x.csv", "x_derived.csv", "out/manifest.json", "out/b.csv", "out/tests/a/b.csv", "out/laws"),
    *("out/tests/a/posterior.nc", "out/tests/a/posterior", "out/population.nc", "out/priors.toml"),
    *(
        "here/out/priors.toml",
        "out/campaign.toml",
        "out/report.html",
        "out",
        ".",
        "..",
        "",
        "m.CSV",
    ),
    *("é.csv", "a b.csv", "a\nb.csv", "x" * 300, "x" * 250, ".hidden", "b.csv.csv", "b.PNG"),
    *("m.csv/b.csv", "out/.owner.json", "out/figures/f.csv", "-o", "circle/b.csv", "a\0b.csv"),
)
THINGS = ("none", "none", "none", "ours", "mine", "pipe", "device", "link", "dangling", "folder")


def seed() -> bytes:
    """A question with nothing in its way."""
    return json.dumps({"bands": "b.csv", "motion": "m.csv", "force": False, "things": {}}).encode()


def mutate_question(_: bytes, rng: Rng) -> bytes:
    """Where to write, what is read, and what lies there already."""
    bands = NAMES[rng.integers(len(NAMES))]
    ends = (".png", "_history.png", "_derived.csv", "_design.csv")
    places = [bands, *(bands.removesuffix(".csv") + end for end in ends)]
    things = {place: THINGS[rng.integers(len(THINGS))] for place in places}
    motion = ("m.csv", "x_derived.csv", "here/m.csv")[rng.integers(3)]
    said = {"bands": bands, "motion": motion, "force": bool(rng.random() < 0.4), "things": things}
    return json.dumps(said).encode()


def files_of_question() -> dict[str, bytes]:
    """A folder with the files of a run, two motions and a question."""
    motion = b"time_s,displacement_in\n0,0\n1,1\n"
    names = ("manifest.json", "population.nc", "priors.toml", "tests/a/posterior.nc")
    named = {f"out/{name}": name.encode() for name in names}
    return named | {"m.csv": motion, "x_derived.csv": motion, "question.json": seed()}


def read_predicted(path: Path) -> object:
    """What `predict` does with its outputs: checks them, and writes; nothing else may change."""
    return _checked(path, _predict)


def read_looked(path: Path) -> object:
    """What `inspect` and `prior-check` do with theirs."""
    return _checked(path, _look)


def _predict(home: Path, said: dict[str, Any]) -> None:
    bands, motion = home / str(said["bands"]), home / str(said["motion"])
    force = bool(said["force"])
    question = Question(bands, "1 ksi", motion, design=True, force=force)
    check_question(question)
    write_text(bands, BANDS)
    write_text(question.beside("derived.csv"), DERIVED)
    write_text(question.beside("design.csv"), DESIGN)
    write_bytes(question.picture, PNG)
    write_bytes(question.beside("history.png"), PNG)


def _look(home: Path, said: dict[str, Any]) -> None:
    place, motion = home / str(said["bands"]), home / str(said["motion"])
    outputs = [place, home / "comparison.csv"]
    check_outputs(outputs, [motion, home / "x_derived.csv"], force=bool(said["force"]))
    write_bytes(place, PNG)


def _checked(path: Path, act: Callable[[Path, dict[str, Any]], None]) -> object:
    home = path.parent
    said = json.loads(path.read_text())
    said["run"] = [str(p.relative_to(home)) for p in (home / "out").rglob("*") if p.is_file()]
    (home / "here").symlink_to(".")
    (home / "circle").symlink_to("circle")
    (home / "sub").mkdir()
    for place, thing in said["things"].items():
        _put(home, place, thing)
    before = _state(home)
    try:
        act(home, said)
    except MfdError:
        _compare(before, _state(home), set())
        raise
    may = _replaceable(home, said)
    for thing in ("here", "circle"):
        (home / thing).unlink()
    _compare(before, _state(home), may)
    return sorted(_state(home).keys() - before.keys())


def _replaceable(home: Path, said: dict[str, Any]) -> set[str]:
    """Names that may be replaced: those of outputs, by force."""
    named = [place for place in said["things"] if said["force"]]
    paths = [home / name for name in named if "\0" not in name]
    places = {path.parent.resolve() / path.name for path in paths}
    found = {str(place.relative_to(home)) for place in places if place.is_relative_to(home)}
    return found - {said["motion"].removeprefix("here/"), *said["run"]}


def _put(home: Path, place: str, thing: str) -> None:
    """Put something where an output goes, if nothing is there."""
    path = home / place
    try:
        if thing == "none" or os.path.lexists(path) or not path.name:
            return
        path.parent.mkdir(parents=True, exist_ok=True)
        if thing == "pipe" or (thing == "device" and os.geteuid() != 0):
            os.mkfifo(path)
        elif thing == "device":
            os.mknod(path, 0o20666, os.makedev(1, 3))
        elif thing in ("link", "dangling"):
            path.symlink_to(home / "m.csv" if thing == "link" else "/nowhere/none")
        elif thing == "folder":
            path.mkdir()
        else:
            text = {".png": PNG.decode("latin-1")}.get(path.suffix, BANDS)
            text = DERIVED if "_derived" in path.name else text
            text = DESIGN if "_design" in path.name else text
            path.write_bytes(text.encode("latin-1") if thing == "ours" else b"mine")
    except (OSError, ValueError):
        return


def _state(home: Path) -> dict[str, object]:
    """Every file with its content, every other thing with its kind and target."""
    found: dict[str, object] = {}
    for path in home.rglob("*"):
        mode = path.lstat().st_mode
        name = str(path.relative_to(home))
        if stat.S_ISREG(mode):
            found[name] = path.read_bytes()
        else:
            found[name] = (stat.S_IFMT(mode), str(path.readlink()) if path.is_symlink() else "")
    return found


def _compare(before: dict[str, object], after: dict[str, object], may: set[str]) -> None:
    """Raise where something was lost that may not be."""
    for name, thing in before.items():
        if name in ("here", "circle") and name not in after:
            continue
        if after.get(name) != thing and name not in may:
            raise AssertionError(f"{name} was replaced by {after.get(name)!r:.80}")
