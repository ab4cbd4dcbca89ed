"""First files of a campaign or a building, and a check of its priors."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mfd_bayes.applications.buildings.building import example_building
from mfd_bayes.applications.buildings.ground import example_ground
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.priors import WRITTEN, PriorFile, load_priors
from mfd_bayes.campaign.campaign import Campaign, load_campaign
from mfd_bayes.campaign.draft import (
    Draft,
    campaign_text,
    draft_campaign,
    has_own_parameters,
    own_priors,
    priors_of_model,
    priors_text,
    ranges_of,
)
from mfd_bayes.errors import CampaignError, MfdError, RecordError
from mfd_bayes.evaluation.scores import QuantileBand, fan_of
from mfd_bayes.friction.model import Model
from mfd_bayes.pipeline.inspect import gap_of, system_of_records
from mfd_bayes.records.cycles import Scales, scales_of
from mfd_bayes.records.record import Record
from mfd_bayes.records.trace import Trace
from mfd_bayes.runs.folder import check_outputs
from mfd_bayes.runs.unit_system import UnitSystem
from mfd_bayes.store.files import write_bytes, write_text

PRIOR_DRAWS = 400

MOST = 0.5
"""Share of a test's force inside the 95 % prior band below which its priors are wrong."""


@dataclass(frozen=True)
class PriorCheck:
    """What the priors of a campaign allow."""

    tests: tuple[tuple[str, float, Path], ...]
    unloaded: tuple[str, ...]
    outlying: tuple[str, ...]
    wrong: str


def prior_check(path: Path, folder: Path, *, force: bool = False, units: str = "") -> PriorCheck:
    """Prior predictive loops compared with the data of every test, with a PNG each in `folder`.

    With `force`, a PNG that exists is replaced.
    """
    from mfd_bayes.reporting.figures import draw_loops, to_png

    campaign = load_campaign(path)
    priors = load_priors(campaign.priors, campaign.folder, campaign.force_model)
    pictures = {test.id: folder / f"{path.stem}_{test.id}_prior.png" for test in campaign.tests}
    inputs = [path, *(test.path for test in campaign.tests)]
    check_outputs(pictures.values(), inputs, force=force)
    records = {test.id: test.read() for test in campaign.tests}
    system = system_of_records(records.values(), units)
    shares, traces = {}, {}
    for name, record in records.items():
        traces[name] = trace = record.trace(campaign.rate, gap=gap_of(campaign.force_model, priors))
        if trace.force is None:
            raise RecordError(f"test {name!r} of {path} has no force to compare with")
        fan = prior_fan(campaign, priors, trace)
        figure = draw_loops(f"{name}: data over what the priors allow", trace, [fan], system)
        write_bytes(pictures[name], to_png(figure))
        shares[name] = share_inside(fan, trace)
    zero_actuation = [name for name, trace in traces.items() if trace.reference_actuation == 0.0]
    noted = zero_actuation if len(zero_actuation) < len(traces) else []
    missed = [name for name, share in shares.items() if share < MOST]
    outlying = tuple(name for name in missed if name not in noted)
    misfit = most_wrong(priors, campaign.force_model, [traces[name] for name in outlying])
    return PriorCheck(
        tuple((name, share, pictures[name]) for name, share in shares.items()),
        tuple(name for name in missed if name in noted),
        outlying,
        misfit.sentence(system) if misfit else "",
    )


@dataclass(frozen=True)
class Misfit:
    """A prior's median, `expected`, and what a record shows, `observed`, in `unit`.

    `z` is their distance in standard deviations of the prior, `source` where the figure is read.
    """

    quantity: str
    unit: str
    expected: float
    observed: float
    z: float
    source: str

    def sentence(self, system: UnitSystem) -> str:
        """What is wrong with the prior, and what would mend it."""
        value = system.words([self.observed], self.unit, 3)
        return (
            f"the prior most wrong is that of {self.quantity}: its median is "
            f"{system.words([self.expected], self.unit, 3)}, and {self.source} is {value}, "
            f"{self.z:.2g} of its standard deviations away; give it a median of about {value}, "
            "or let mfd-bayes init write priors.toml from the records"
        )


def prior_fan(campaign: Campaign, priors: PriorFile, trace: Trace) -> QuantileBand:
    """Bands of the force under the prior, without noise, for a test's motion."""
    posterior = Posterior(trace, priors, campaign.noise, campaign.force_model)
    draws = posterior.sample_prior(PRIOR_DRAWS, 0)
    return fan_of("prior", posterior.force(draws) + draws["offset"][:, None])


def share_inside(fan: QuantileBand, trace: Trace) -> float:
    """Share of the samples whose force is inside the widest band."""
    force, widest = np.asarray(trace.force), fan.widest
    return float(np.mean((force >= widest.lower) & (force <= widest.upper)))


def most_wrong(priors: PriorFile, model: Model, traces: Sequence[Trace]) -> Misfit | None:
    """The prior of a model that is farthest from what records show, by its own spread.

    None where the records show no scales, or no prior can be compared with one.
    """
    scales = [record_scales for trace in traces if (record_scales := scales_of(trace)) is not None]
    misfits = (
        misfit
        for record_scales in scales
        for misfit in _misfits(priors, record_scales, model.standard_names)
    )
    return max(misfits, key=lambda misfit: misfit.z, default=None)


def _misfits(priors: PriorFile, scales: Scales, names: frozenset[str]) -> Iterator[Misfit]:
    """Each prior that a record shows something of, beside it."""
    slip = ("kip", scales.force, "the slip force of the loop")
    rise = ("kip/in", scales.build_up, "the slope at which the force comes back")
    estimates = {
        **dict.fromkeys(("Fc_fwd", "Fc_bwd", "Fy_fwd", "Fy_bwd"), slip),
        "sigma0": ("kip/in", scales.unloading, "the slope after a reversal"),
        **dict.fromkeys(("k3", "k", "k_fwd", "k_bwd"), rise),
        "d2": ("in", 0.5 * scales.length, "half the travel until the force has come back"),
    }
    for name, (unit, value, source) in estimates.items():
        prior = priors.parameters.get(name)
        if prior is None or name not in names:
            continue
        draws = prior.draw(np.random.default_rng(0), 1001)
        middle, estimate = prior.median, value
        if prior.on_half_line:
            draws, middle = np.log(draws), float(np.log(middle))
            estimate = float(np.log(value)) if value > 0.0 else np.nan
        spread = float(np.std(draws))
        if spread > 0.0 and np.isfinite(estimate):
            yield Misfit(name, unit, prior.median, value, abs(estimate - middle) / spread, source)


def init(folder: Path, model: str = "", *, force: bool = False) -> tuple[Path, Draft, bool]:
    """Path and content of a first campaign.toml, written for the test files in a folder.

    Also returns whether priors.toml was written too: where the units are known, for a user's own
    model, "file.py:Class", and for a device that no shipped file knows.
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


def init_priors(path: Path, model: str, *, force: bool) -> tuple[Path, bool]:
    """Path of a prior file beside a campaign, its scales read off the campaign's records.

    It is for the campaign's model, or another one. Also returns whether the campaign names it
    already.
    """
    campaign = load_campaign(path, model or None)
    written = campaign.folder / WRITTEN
    _check_new([written], force=force)
    records = {test.id: test.read() for test in campaign.tests if test.role == "calibrate"}
    if has_own_parameters(campaign.force_model) and records:
        text = priors_of_model(campaign.force_model, [ranges_of(r) for r in records.values()])
    else:
        scales = {name: scales_of(record.trace()) for name, record in records.items()}
        known_scales = {name: scale for name, scale in scales.items() if scale is not None}
        if not known_scales:
            raise CampaignError(f"no test of {path} has a force, so it shows no scales of priors")
        force_unit, length = (_usual_unit(records.values(), r) for r in ("force", "displacement"))
        text = priors_text(known_scales, force_unit, length)
    write_text(written, text)
    return written, campaign.priors == WRITTEN


def init_building(path: Path, *, force: bool) -> Path:
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
