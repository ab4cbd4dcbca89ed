"""A first campaign file, prior file or building file, written for what is there."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from pathlib import Path

from mfd_bayes.calibration.priors import WRITTEN
from mfd_bayes.campaign.campaign import load_campaign
from mfd_bayes.campaign.draft import Draft, campaign_text, draft_campaign, own_priors, priors_text
from mfd_bayes.errors import CampaignError, MfdError
from mfd_bayes.records.loops import scales_of
from mfd_bayes.records.record import Record
from mfd_bayes.response.building import example_building
from mfd_bayes.response.ground import example_ground
from mfd_bayes.store.files import write_text


def init(folder: Path, model: str = "", *, force: bool = False) -> tuple[Path, Draft, bool]:
    """Path and content of a first campaign.toml, written for the test files in a folder.

    Also returns whether priors.toml was written too: always for a user's own model,
    "file.py:Class", else where no shipped file knows such a device.
    """
    path, priors = folder / "campaign.toml", folder / WRITTEN
    _check_new([path], force=force)
    draft = draft_campaign(folder, model)
    text = own_priors(draft)
    if text is not None:
        _check_new([priors], force=force)
        write_text(priors, text)
    write_text(path, campaign_text(draft))
    return path, draft, text is not None


def init_priors(path: Path, *, force: bool = False) -> tuple[Path, bool]:
    """Path of a prior file beside a campaign, its scales read off the campaign's records.

    Also returns whether the campaign names it already.
    """
    campaign = load_campaign(path)
    written = campaign.folder / WRITTEN
    _check_new([written], force=force)
    records = {test.id: test.read() for test in campaign.tests if test.role == "calibrate"}
    scales = {name: scales_of(record.trace()) for name, record in records.items()}
    known = {name: scale for name, scale in scales.items() if scale is not None}
    if not known:
        raise CampaignError(f"no test of {path} has a force, so it shows no scales of priors")
    force_unit, length = (_usual_unit(records.values(), r) for r in ("force", "displacement"))
    write_text(written, priors_text(known, force_unit, length))
    return written, campaign.priors == WRITTEN


def init_building(path: Path, *, force: bool = False) -> Path:
    """Write a first building file, and an artificial ground motion, ground.AT2, beside it.

    Its actuation is one of the campaign beside it, if there is any.
    """
    target = path / "building.toml" if path.is_dir() or path.suffix != ".toml" else path
    ground, text = target.with_name("ground.AT2"), example_building()
    _check_new([target, ground], force=force)
    try:
        tests = load_campaign(target.with_name("campaign.toml")).tests
    except MfdError:  # none, or one that is not complete
        tests = ()
    if levels := [test.actuation for test in tests if test.actuation]:
        text = text.replace('"1000 psi"', f'"{levels[len(levels) // 2]}"')
    write_text(target, text)
    write_text(ground, example_ground())
    return target


def _check_new(paths: Iterable[Path], *, force: bool) -> None:
    for path in paths:
        if path.exists() and not force:
            raise CampaignError(f"{path} exists: give --force to replace it")


def _usual_unit(records: Iterable[Record], role: str) -> str:
    """Unit that most records have for a role."""
    units = [record.columns[role][1] for record in records if role in record.columns]
    return Counter(units).most_common(1)[0][0]
