"""The command `accept`: what it writes and prints."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import typer

from mfd_bayes.applications.acceptance.judgement import Acceptance, accept, default_limits
from mfd_bayes.applications.acceptance.options import AcceptOptions
from mfd_bayes.applications.acceptance.page import acceptance_table
from mfd_bayes.console import print_rows, say, warn
from mfd_bayes.errors import CampaignError
from mfd_bayes.records.cycles import LIMITS
from mfd_bayes.reporting.tables import to_csv
from mfd_bayes.runs.folder import check_folder
from mfd_bayes.runs.run import Run, actuation_level, open_run
from mfd_bayes.runs.stated import (
    read_as_tests,
    stated_actuation,
    stated_conditions,
    stated_uncertainty,
)
from mfd_bayes.store.files import remove_file, write_bytes, write_text

# --- devices are compared with the others

_LIMIT = re.compile(r"\s*(\w+)\s*=\s*(\d+(?:\.\d+)?)\s*(%?)\s*")


def run_accept(options: AcceptOptions) -> None:
    """Compare devices with the others, and print it; exit code 1 where one is rejected."""
    devices, pages = accept_records(options)
    warn(remark for each in devices for remark in each.remarks)
    if not options.quiet:
        for each in devices:
            heads = ["effect, %", "90 % interval", "limit - guard band, %", "percentile", "p"]
            heads.append("verdict")
            rows = [
                (f"{row['quantity']} {row['direction']}".strip(), *_effect_cells(row))
                for _, row in each.rows.iterrows()
            ]
            print_rows(f"{each.device}: {each.verdict}", ["quantity", *heads], rows)
    for each in devices:
        say(f"{each.device}: {each.sentence}")
    if not options.quiet:
        say(f"look next at {pages[0]}")
    if any(each.verdict == "rejected" for each in devices):
        raise typer.Exit(1)


def _effect_cells(row: Any) -> tuple[str, ...]:
    """Cells of a quantity of a device that is compared with the others."""
    has = math.isfinite(row["effect"])
    return (
        f"{row['effect']:+.1f}" if has else "",
        f"{row['effect_lower']:+.1f} to {row['effect_upper']:+.1f}" if has else "",
        f"±{row['limit']:.3g} - {row['guard_band']:.1f}" if math.isfinite(row["limit"]) else "",
        f"{row['percentile']:.1f}",
        f"{row['p_value']:.3f}",
        str(row["verdict"]),
    )


def parse_limits(texts: tuple[str, ...]) -> dict[str, float]:
    """Limits of texts such as "slip=15 %"."""
    limits = {}
    for text in texts:
        read = _LIMIT.fullmatch(text)
        if read is None:
            raise CampaignError(
                f"--limit reads 'slip=15 %', with {', '.join(LIMITS)} or all, got {text!r}"
            )
        limits[read[1]] = float(read[2]) / (100.0 if read[3] else 1.0)
    return limits


def accept_records(options: AcceptOptions) -> tuple[tuple[Acceptance, ...], tuple[Path, ...]]:
    """Compare devices with those of a run; table, pages (returned) and picture are written."""
    check_folder(options.folder, force=options.force)
    limits, uncertainty = parse_limits(options.limit), stated_uncertainty(options.uncertainty)
    run = replace(open_run(options.out, trust=options.trust_model), units=options.units)
    options = replace(options, actuation=stated_actuation(run, options.actuation))
    actuation_level(run, options.actuation)
    records = [read_as_tests(run, path, options.actuation) for path in options.records]
    device = options.device[0] if len(options.device) == 1 else options.device or ""
    devices = accept(
        *(run, records),
        device=device,
        limits=limits or None,
        session=options.session,
        conditions=stated_conditions(options),
        draws=options.draws,
        seed=options.seed,
        uncertainty=uncertainty,
    )
    return devices, _write_acceptance(run, options, devices)


def _write_acceptance(
    run: Run, options: AcceptOptions, devices: tuple[Acceptance, ...]
) -> tuple[Path, ...]:
    from mfd_bayes.applications.acceptance.page import acceptance_page, draw_batch
    from mfd_bayes.reporting.figures import to_png

    today, manifest, folder = datetime.now(UTC).date().isoformat(), run.manifest, options.folder
    names = [name for name in run.devices if name]
    compared = f"{len(names)} devices ({', '.join(names)})" if names[1:] else "one device"
    provenance = (
        f"{manifest.title}, {run.folder.resolve().name} (seed {manifest.seed}, {manifest.finished})"
    )
    actuation = {"actuation": options.actuation} if run.system.axes.actuated else {}
    load_cell = {"load cell": f"another, {options.uncertainty}"} if options.uncertainty else {}
    heading = [f"run {provenance}", *(f"actuation {level}" for level in actuation.values())]
    heading += [f"load cell: {words}" for words in load_cell.values()]
    heading.append(f"date {today}")
    heading += [f"{d.device}: {d.sentence}" for d in devices]
    write_text(folder / "acceptance.csv", to_csv(acceptance_table(devices, run.system), heading))
    pages: list[Path] = []
    for device in devices:
        facts = {
            f"record {i}": f"{c.record.path.name}, SHA-256 {c.record.sha256}"
            for i, c in enumerate(device.comparisons, start=1)
        }
        facts |= {
            **actuation,
            **load_cell,
            "limits": "as given" if options.limit else default_limits(run)[1],
            "compared with": f"{provenance}: {len(run.tests)} calibrated tests of {compared}",
            "program": f"mfd_bayes {manifest.versions.get('mfd_bayes', '')}",
        }
        name = re.sub(r"[^\w+-]+", "_", device.device).strip("_")[:80] or "device"
        path = folder / f"{name}.html"
        if path in pages:
            path = folder / f"{name}_{len(pages) + 1}.html"
        write_text(path, acceptance_page(device, facts, today, len(devices), run.system))
        pages.append(path)
    picture = folder / "acceptance.png"
    if len(devices) > 1:
        write_bytes(picture, to_png(draw_batch(devices)))
    else:
        remove_file(picture)
    return tuple(pages)
