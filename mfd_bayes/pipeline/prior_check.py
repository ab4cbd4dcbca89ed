"""What the priors of a campaign allow, beside the data of every test."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from mfd_bayes.calibration.priors import load_priors
from mfd_bayes.campaign.campaign import load_campaign
from mfd_bayes.errors import RecordError
from mfd_bayes.evaluation.prior_check import MOST, most_wrong, prior_fan, share_inside
from mfd_bayes.pipeline.findings import gap_of
from mfd_bayes.pipeline.inspect import system_of_records
from mfd_bayes.pipeline.outputs import check_outputs
from mfd_bayes.reporting.conversion import convert_fan, convert_trace
from mfd_bayes.store.files import write_bytes


@dataclass(frozen=True)
class PriorCheck:
    """What the priors of a campaign allow."""

    tests: tuple[tuple[str, float, Path], ...]
    unloaded: tuple[str, ...]
    outside: tuple[str, ...]
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
        shown = convert_trace(trace, system), [convert_fan(fan, system.factor("kip"))]
        figure = draw_loops(f"{name}: data over what the priors allow", *shown, system)
        write_bytes(pictures[name], to_png(figure))
        shares[name] = share_inside(fan, trace)
    still = [name for name, trace in traces.items() if trace.reference_actuation == 0.0]
    noted = still if len(still) < len(traces) else []
    missed = [name for name, share in shares.items() if share < MOST]
    outside = tuple(name for name in missed if name not in noted)
    misfit = most_wrong(priors, campaign.force_model, [traces[name] for name in outside])
    return PriorCheck(
        tuple((name, share, pictures[name]) for name, share in shares.items()),
        tuple(name for name in missed if name in noted),
        outside,
        misfit.sentence(system) if misfit else "",
    )
