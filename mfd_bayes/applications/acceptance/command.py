"""The command `accept`: its options, and what is written."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

from mfd_bayes.applications.acceptance.judgement import DRAWS as ACCEPTANCE_DRAWS
from mfd_bayes.applications.acceptance.judgement import LIMITS, Acceptance, accept
from mfd_bayes.applications.acceptance.page import acceptance_table
from mfd_bayes.errors import CampaignError
from mfd_bayes.reporting.tables import to_csv
from mfd_bayes.runs.folder import check_folder
from mfd_bayes.runs.run import Run, open_run
from mfd_bayes.runs.stated import read_as_tests, stated_actuation, stated_conditions
from mfd_bayes.store.files import remove_file, write_bytes, write_text

# --- devices are compared with the others

_LIMIT = re.compile(r"\s*(\w+)\s*=\s*(\d+(?:\.\d+)?)\s*(%?)\s*")


@dataclass(frozen=True)
class Inspection:
    """Records of devices that are to be compared with the others; the options of the command.

    `device` is that of all records, or of each; by default each record is of another one. `limit`
    is such as "slip=15 %", by default that of the campaign, else 15 % of all.
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
    draws: int = ACCEPTANCE_DRAWS
    seed: int = 0
    units: str = ""
    force: bool = False
    trust_model: bool = False


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


def accept_records(out: Path, wish: Inspection) -> tuple[tuple[Acceptance, ...], tuple[Path, ...]]:
    """Compare devices with those of a run; table, pages (returned) and picture are written."""
    check_folder(wish.folder, force=wish.force)
    limits = parse_limits(wish.limit)
    run = replace(open_run(out, trust=wish.trust_model), units=wish.units)
    wish = replace(wish, actuation=stated_actuation(run, wish.actuation))
    run.level_of(wish.actuation)
    records = [read_as_tests(run, path, wish.actuation) for path in wish.records]
    device = wish.device[0] if len(wish.device) == 1 else wish.device or ""
    devices = accept(
        *(run, records),
        device=device,
        limits=limits or None,
        session=wish.session,
        conditions=stated_conditions(wish),
        draws=wish.draws,
        seed=wish.seed,
    )
    return devices, _write_acceptance(run, wish, devices)


def _write_acceptance(
    run: Run, wish: Inspection, devices: tuple[Acceptance, ...]
) -> tuple[Path, ...]:
    from mfd_bayes.applications.acceptance.page import acceptance_page, draw_batch
    from mfd_bayes.reporting.figures import to_png

    today, manifest, folder = datetime.now(UTC).date().isoformat(), run.manifest, wish.folder
    names = [name for name in run.devices if name]
    compared = f"{len(names)} devices ({', '.join(names)})" if names[1:] else "one device"
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
            "compared with": f"{made}: {len(run.tests)} calibrated tests of {compared}",
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
