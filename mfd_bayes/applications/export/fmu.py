"""The calibrated damper as an FMU: FMI 2.0 or 3.0, co-simulation, in SI units, sources inside."""

from __future__ import annotations

import io
import platform
import tempfile
import zipfile
from collections.abc import Mapping
from hashlib import sha256
from html import escape
from importlib.metadata import version as version_of
from pathlib import Path
from string import Template

from mfd_bayes.applications.export.c_source import parameters_csv, readme, source, table
from mfd_bayes.applications.export.compiled import compile_library, compiler
from mfd_bayes.applications.export.sets import FIXED, ParameterSets
from mfd_bayes.runs.run import Run
from mfd_bayes.store.files import write_bytes
from mfd_bayes.units import convert

ACTUATIONS = {"ksi": "Pa", "kip": "N"}  # unit of an actuation in SI, others stay as they are
BINARIES = {
    ("Linux", "x86_64"): ("linux64", "x86_64-linux", "so"),
    ("Linux", "aarch64"): ("", "aarch64-linux", "so"),
    ("Darwin", "x86_64"): ("darwin64", "x86_64-darwin", "dylib"),
    ("Darwin", "arm64"): ("", "aarch64-darwin", "dylib"),
}
"""Folder of a binary by FMI 2.0, which has none for some machines, and by 3.0; its suffix."""

ACTUATION_2 = """
    <ScalarVariable name="actuation" valueReference="2" causality="input" variability="continuous"
      description="at the end of the next step; tested: $tested">
      <Real$unit start="$level"/>
    </ScalarVariable>"""
ACTUATION_3 = """
    <Float64 name="actuation" valueReference="2" causality="input" variability="continuous"$unit
      start="$level" description="at the end of the next step; tested: $tested"/>"""


def fmu_files(run: Run, sets: ParameterSets, fmi: str) -> dict[str, str]:
    """Text files of an FMU by their paths in it."""
    major = fmi[0]
    unit = ACTUATIONS.get(sets.unit, "")
    level = sets.level * (convert(sets.unit, unit) if unit else 1.0)
    tested = next((span.words(run.system) for span in run.tested if span.name == "actuation"), "")
    lines = table(sets)
    token = "{" + sha256((fmi + lines + source("damper.c")).encode()).hexdigest()[:32] + "}"
    values = {
        "name": sets.model.name,
        "token": token,
        "title": escape(run.manifest.title),
        "version": version_of("mfd_bayes"),
        "draws": len(sets.names) - len(FIXED),
        "level": repr(level),
        "tested": escape(tested),
        "unit": f' unit="{unit}"' if unit else "",
    }
    template = ACTUATION_2 if major == "2" else ACTUATION_3
    actuation = Template(template).substitute(values) if sets.unit else ""
    units = "#define DAMPER_UNITS "  # 1: those of the description
    header = f'#define FMU_TOKEN "{token}"\n#define FMU_ACTUATION {level!r}\n'
    description = Template(source(f"fmi{major}.xml")).substitute(values, actuation=actuation)
    page = f"<html><body><pre>{escape(readme(run, sets))}</pre></body></html>\n"
    return {
        "modelDescription.xml": description,
        "sources/damper.h": source("damper.h").replace(f"{units}0", f"{units}1"),
        "sources/damper.c": source("damper.c"),
        "sources/damper_sets.c": lines,
        "sources/fmu.h": source("fmu.h"),
        "sources/fmu_model.h": header,
        f"sources/fmi{major}.c": source(f"fmi{major}.c"),
        "resources/parameters.csv": parameters_csv(sets),
        "documentation/" + ("_main.html" if major == "2" else "index.html"): page,
    } | ({"sources/buildDescription.xml": source("fmi3_build.xml")} if major == "3" else {})


def write_fmu(run: Run, sets: ParameterSets, path: Path, fmi: str) -> list[str]:
    """Write an FMU, with a binary for this machine where there is a compiler; what was written."""
    files: dict[str, str | bytes] = {**fmu_files(run, sets, fmi)}
    places = BINARIES.get((platform.system(), platform.machine()), ("", "", ""))
    folder = places[0 if fmi[0] == "2" else 1]
    binary = bool(compiler() and folder)
    if binary:
        files[f"binaries/{folder}/damper.{places[2]}"] = _binary(files, f"fmi{fmi[0]}.c")
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():  # the same bytes on another day
            entry = zipfile.ZipInfo(name)
            entry.compress_type, entry.external_attr = zipfile.ZIP_DEFLATED, 0o644 << 16
            archive.writestr(entry, content)
    write_bytes(path, buffer.getvalue())
    built = f"with sources and a binary for {folder}"
    if not binary:
        built = (
            "with sources alone, since no compiler of C is found here for this machine: your "
            "program, or FMPy, compiles it"
        )
    return [
        f"{sets.model.name} as an FMU of FMI {fmi} for co-simulation, in SI units, {built}: {path}",
        f"its parameter set: nominal, lower, upper, or a draw's number, 1 to "
        f"{len(sets.names) - len(FIXED)}",
    ]


def _binary(files: Mapping[str, str | bytes], interface: str) -> bytes:
    """The shared library of an FMU's sources."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for path, content in files.items():
            if path.startswith("sources/") and isinstance(content, str):
                (folder / Path(path).name).write_text(content, encoding="utf-8")
        library = folder / "damper.library"
        sources = "damper.c", "damper_sets.c", interface
        compile_library(folder, sources, library, "-fvisibility=hidden")  # but for the standard's
        return library.read_bytes()
