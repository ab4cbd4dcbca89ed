"""Whether devices are like the others, from their records and a finished run, written as files."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

from mfd_bayes.errors import CampaignError
from mfd_bayes.evaluation.acceptance import DRAWS, LIMITS, Acceptance, accept
from mfd_bayes.pipeline.outputs import check_folder
from mfd_bayes.pipeline.predict import stated_actuation, stated_conditions
from mfd_bayes.records.readers import read_table
from mfd_bayes.records.record import Record, read_record
from mfd_bayes.reporting.acceptance import acceptance_page, acceptance_table, draw_batch
from mfd_bayes.reporting.tables import to_csv
from mfd_bayes.runs.run import Run, open_run
from mfd_bayes.runs.unit_system import System
from mfd_bayes.store.files import remove_file, write_bytes, write_text

_LIMIT = re.compile(r"\s*(\w+)\s*=\s*(\d+(?:\.\d+)?)\s*(%?)\s*")


@dataclass(frozen=True)
class Inspection:
    """Records of devices that are to be compared with the others.

    Attributes
    ----------
    records : tuple of Path
    actuation : str
        Of all of them, such as "1000 psi".
    folder : Path
        Of the table and the pages.
    device : tuple of str
        Device of all records, or of each; by default each record is of another one.
    limit : tuple of str
        Such as "slip=15 %"; by default those of the campaign, else 15 % of all.
    session : str
        In which the records were made.
    date, cycles, temperature : str, float and str
        Of the records, as in a campaign's `[[test]]`; "" and None where they are not known.
    """

    records: tuple[Path, ...]
    folder: Path
    actuation: str = ""
    device: tuple[str, ...] = ()
    limit: tuple[str, ...] = ()
    session: str = ""
    date: str = ""
    cycles: float | None = None
    temperature: str = ""
    draws: int = DRAWS
    seed: int = 0
    units: str = ""
    force: bool = False


@dataclass(frozen=True, eq=False)
class Accepted:
    """Devices with their verdicts, and the files that say so."""

    devices: tuple[Acceptance, ...]
    system: System
    table: Path
    pages: tuple[Path, ...]

    @property
    def rejected(self) -> bool:
        """Whether one device or more is rejected."""
        return any(device.verdict == "rejected" for device in self.devices)


def parse_limits(texts: tuple[str, ...]) -> dict[str, float]:
    """Limits of texts such as "slip=15 %"."""
    found = {}
    for text in texts:
        read = _LIMIT.fullmatch(text)
        if read is None:
            raise CampaignError(
                f"--limit reads 'slip=15 %', with {', '.join(LIMITS)} or all, got {text!r}"
            )
        found[read[1]] = float(read[2]) / (100.0 if read[3] else 1.0)
    return found


def read_as_tests(run: Run, path: Path, actuation: str) -> Record:
    """A record by the campaign's columns where the file has them, else by its own headers."""
    stated = run.manifest.settings.columns.given
    names, axes = read_table(path).names, run.system.axes
    columns = {role: c.source for role, c in stated.items() if role != "actuation"}
    there = all(c.key in names or c.name is None for r, c in stated.items() if r in columns)
    return read_record(path, columns if columns and there else None, actuation=actuation, axes=axes)


def accept_records(out: Path, wish: Inspection) -> Accepted:
    """Compare devices with those of a run; table, pages and picture are written.

    Raises
    ------
    MfdError
        When the run, a record, the actuation or a limit cannot be used.
    """
    check_folder(wish.folder, force=wish.force)
    limits = parse_limits(wish.limit)
    run = open_run(out)
    if wish.units:
        run = replace(run, units=wish.units)
    wish = replace(wish, actuation=stated_actuation(run, wish.actuation))
    run.level_of(wish.actuation)
    records = [read_as_tests(run, path, wish.actuation) for path in wish.records]
    device = wish.device[0] if len(wish.device) == 1 else wish.device or ""
    with run.unchanged():
        devices = accept(
            *(run, records),
            device=device,
            limits=limits or None,
            session=wish.session,
            conditions=stated_conditions(wish),
            draws=wish.draws,
            seed=wish.seed,
        )
    pages = _write(run, wish, devices)
    return Accepted(devices, run.system, wish.folder / "acceptance.csv", pages)


def _write(run: Run, wish: Inspection, devices: tuple[Acceptance, ...]) -> tuple[Path, ...]:
    from mfd_bayes.reporting.figures import to_png

    today, manifest, folder = datetime.now(UTC).date().isoformat(), run.manifest, wish.folder
    made = (
        f"{manifest.title}, {run.folder.resolve().name} (seed {manifest.seed}, {manifest.finished})"
    )
    actuation = {"actuation": wish.actuation} if run.system.axes.actuated else {}
    heading = [f"run {made}", *(f"actuation {level}" for level in actuation.values())]
    heading.append(f"date {today}")
    heading += [f"{d.device}: {d.sentence}" for d in devices]
    write_text(folder / "acceptance.csv", to_csv(acceptance_table(devices, run.system), heading))
    pages: list[Path] = []
    for device in devices:
        about = {
            f"record {i}": f"{c.record.path.name}, SHA-256 {c.record.sha256}"
            for i, c in enumerate(device.comparisons, start=1)
        }
        about |= {
            **actuation,
            "compared with": f"{made}: {len(run.tests)} calibrated tests of {_devices(run)}",
            "program": f"mfd_bayes {manifest.versions.get('mfd_bayes', '')}",
        }
        name = re.sub(r"[^\w+-]+", "_", device.device).strip("_")[:80] or "device"
        path = folder / f"{name}.html"
        if path in pages:
            path = folder / f"{name}_{len(pages) + 1}.html"
        write_text(path, acceptance_page(device, about, today, len(devices), run.system))
        pages.append(path)
    picture = folder / "acceptance.png"
    if len(devices) > 1:
        write_bytes(picture, to_png(draw_batch(devices)))
    else:
        remove_file(picture)
    return tuple(pages)


def _devices(run: Run) -> str:
    names = [name for name in run.devices if name]
    return f"{len(names)} devices ({', '.join(names)})" if len(names) > 1 else "one device"
