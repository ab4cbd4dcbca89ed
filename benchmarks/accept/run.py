"""How often do good devices differ, are wrong ones found, and do verdicts err as often as stated?

    python -m benchmarks.accept.run good     minutes of a core for each of five prototypes
    python -m benchmarks.accept.run drift    five inspections, by the mixed model
    python -m benchmarks.accept.run real     real sessions, calibrated by benchmarks.heldout.run
    python -m benchmarks.accept.run gain     intervals of slip force of a load cell that is off
    python -m benchmarks.accept.run guard    risks of wrong verdicts; minutes of a core

and the same with --quick, few of each. `good` calibrates simulated prototypes of twelve tests, and
judges 2,000 good devices and 200 of each fault after three cycles at limits of 15 %. `real` leaves
every harmonic record of both sessions out of the run that it is compared with, unaltered and with a
planted fault, and compares the 30 lb records of 2023 with the session of 2022. `guard` judges 2,000
devices whose forces are off by up to three limits, in either direction alike, and compares the
stated probabilities of wrong verdicts with the shares of wrong ones: each device of a campaign of
its own, whose truth is drawn from the priors of the mixed model; and devices of the simulated
prototypes of `good`. Another load cell than that of the tests measures them. `gain` asks how many
intervals of the mean slip force hold its true value, in 200 campaigns of twelve tests.
"""

from benchmarks import common  # isort: skip  (one thread, before numpy)

import sys
from collections import Counter
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd

import mfd_bayes as mb
from mfd_bayes.applications.acceptance import judgement as acceptance
from mfd_bayes.calibration.priors import load_priors
from mfd_bayes.campaign import synthetic
from mfd_bayes.campaign.schema import CampaignFile
from mfd_bayes.campaign.synthetic import Matrix, draw_record, draw_values, write_campaign
from mfd_bayes.evaluation import measurement
from mfd_bayes.evaluation.laws import drift_row
from mfd_bayes.evaluation.measurement import EXACT, Gains
from mfd_bayes.population.design import LAW_NAMES, TestConditions, design_of
from mfd_bayes.population.mixed_model import MixedModel
from tests.population.made import sample_h

MATRIX = Matrix((600.0, 1000.0, 1400.0), (0.1, 0.25, 0.5, 1.0), (2, 3, 3, 4), (800.0, 0.5))
ACTUATION, FREQUENCY, CYCLES = 1.0, 0.5, 3  # ksi and Hz of a production test
SCATTER = 0.02  # of slip forces and gap, from test to test
LIMITS = acceptance.complete_limits({"all": 0.15})
SLIP = ("slip_fwd", "slip_bwd")
FAULTS = {
    **{
        f"slip {100 * (by - 1):+.0f} %": ({"Fc_fwd": by, "Fc_bwd": by}, SLIP)
        for by in (0.80, 0.85, 0.90, 1.10, 1.15, 1.20)
    },
    "slip +20 %, forward only": ({"Fc_fwd": 1.2}, ("slip_fwd",)),
    "slip -20 %, backward only": ({"Fc_bwd": 0.8}, ("slip_bwd",)),
    "gap x 1.5": ({"d2": 1.5, "d3": 1.5}, ("gap",)),
    "stiffness of the build-up x 0.7": ({"k3": 0.7, "sigma0": 0.7}, ("build_up_slope",)),
}
"""Factors of quantities, and which quantity of a device is rightly named."""


def table(rows):
    print(pd.DataFrame(rows).to_string(index=False), flush=True)


def share(count, of):
    return f"{100 * count / of:.1f} % ± {100 * np.sqrt(count / of * (1 - count / of) / of):.1f}"


# --- simulated devices


def set_scatter():
    """Let tests of a device scatter in slip force and gap by SCATTER."""
    names = ("Fc_fwd", "Fc_bwd", "d2", "d3", "ell", "k2", "k3", "sigma0")
    excess = ("static_excess_fwd", "static_excess_bwd")
    synthetic._SCATTER |= dict.fromkeys(names, SCATTER) | dict.fromkeys(excess, 2.0 * SCATTER)


def production_test(rng, fault):
    """Time, displacement and force of one test of a device, whose quantities have factors."""
    values = draw_values(ACTUATION, MATRIX.laws, rng)
    for name, factor in fault.items():
        values[name] = values[name] * factor
    return draw_record(values, FREQUENCY, CYCLES, rng)


def prototype(folder, seed):
    """Calibrated run of twelve tests of a prototype; a stored one is opened."""
    if not (folder / "out" / "report.html").exists():
        folder.mkdir(parents=True, exist_ok=True)
        write_campaign(folder, seed, MATRIX)
        path = folder / "campaign.toml"
        text = path.read_text(encoding="utf-8")
        path.write_text(text.replace('"ou"', '"ou"\nrate = "50 Hz"'), "utf-8")
        common.command("calibrate", path, "-o", folder / "out", "--effort", "quick", "--force")
    return mb.open_run(folder / "out")


def comparison(run, folder, rng, draws, gains=EXACT):
    """A function of a force that compares such a test with a run; `gains` as of `expect`."""
    path = folder / "production.csv"
    rows = np.transpose(production_test(rng, {}))
    names = ("time_s", "displacement_in", "force_kip")
    pd.DataFrame(rows, columns=names).to_csv(path, index=False)
    record = mb.read_record(path, actuation="1 ksi")
    how = {"rate": record.rate, "ratios": acceptance.birge_ratios(run), "draws": draws}
    how["gains"] = gains
    expected = acceptance.expect(run, acceptance.trace_of(run, record), "", **how)

    def compare(force):
        altered = replace(record, force=force)
        group = (acceptance.compare_record(altered, acceptance.trace_of(run, altered), expected),)
        return group, acceptance.Level.of(group, independent=True)

    return compare


def counted(label, judged, expected=()):
    verdicts = Counter(device.verdict for device in judged)
    significant = [device for device in judged if device.p_value < 0.05]
    row = {"devices": label, "number": len(judged), "differs": share(len(significant), len(judged))}
    row |= {name: verdicts[name] for name in ("rejected", "cannot tell", "accepted")}
    if expected and significant:
        named = sum(device.named in expected for device in significant)
        row["named rightly"] = share(named, len(significant))
    return row


def good(options):
    set_scatter()
    rng, pool = np.random.default_rng(7), []
    count, number, faulty = (1, 40, 4) if options.quick else (options.prototypes, 2000, 200)
    for seed in range(1, count + 1):
        directory = options.out / f"s{seed}"
        pool.append(comparison(prototype(directory, seed), directory, rng, 4000))

    def judged(number, fault):
        devices = []
        for i in range(number):
            group, level = pool[i % count](production_test(rng, fault)[2])
            devices.append(acceptance.judge(f"{i}", group, level, level.p_value, LIMITS))
        return devices

    fine = judged(number, {})
    by_prototype = [np.mean([d.p_value < 0.05 for d in fine[i::count]]) for i in range(count)]
    print(f"{count} runs of 12 tests of a prototype, {CYCLES} cycles of each device; limits 15 %")
    rows = [counted("good", fine)]
    rows += [counted(name, judged(faulty, f), expected) for name, (f, expected) in FAULTS.items()]
    table(rows)
    error = np.std(by_prototype, ddof=1) / np.sqrt(count) if count > 1 else np.nan
    words = ", ".join(f"{100 * share_of:.0f}" for share_of in by_prototype)
    print(f"\nGood devices that differ, by prototype: {words} %; error {100 * error:.1f} %")
    print("\nPower at a good device: a deviation that is found with 0.80")
    detectable = pd.DataFrame([device.rows["detectable"] for device in fine]).mean()
    print(detectable.dropna().round(1).to_string())
    batches = [fine[i : i + 20] for i in range(0, number, 20)]
    alarms = sum(
        min(acceptance.false_discovery([d.p_value for d in batch])) < 0.05 for batch in batches
    )
    print(f"\nBatches of 20 good devices with a false alarm: {share(alarms, len(batches))}")


def drift(options):
    """Inspections in five years of three tests each, whose slip force scatters by 2 %."""
    rng, rows = np.random.default_rng(8), []
    years = np.repeat(2020.0 + np.arange(5.0), 3)
    tested = [TestConditions(1.0, "", {"date": year}) for year in years]
    laws, follows = {"Fc_fwd": "proportional"}, {"Fc_fwd": ("date",)}
    design = design_of(load_priors("mfd"), ("Fc_fwd",), tested, laws, follows)
    design, choice = replace(design, leveled=False), np.array([0])
    precision = np.full((years.size, 1, 1), (design.spread[0] / 0.005) ** 2)
    for rate, number in ((-0.02, 200), (0.02, 200), (0.0, 1000)):
        number, drifts = 5 if options.quick else number, []
        for _ in range(number):
            values = np.log1p(rate) * (years - 2020.0) + rng.normal(0.0, 0.02, years.size)
            mixed = MixedModel(design, (values / design.spread[0])[:, None], precision)
            h = sample_h(mixed, choice, rng, 1000)
            z = mixed.marginal(h, choice)[1].draw(rng)
            drifts.append(drift_row("Fc_fwd", "date", z[:, 1], years, 0.15))
        true = abs(rate) * 14.0 > 0.15  # four years of tests, and ten after them
        row = {"drift": f"{100 * rate:+.0f} % a year", "number": number}
        row |= {"found": share(sum(d.found for d in drifts), number)}
        row |= {"leaves 15 % in 14 years": "yes" if true else "no"}
        leaves = float(np.mean([d.leaves for d in drifts]))
        rows.append(row | {"mean probability of that": round(leaves, 2)})
    table(rows)


# --- real devices


def changed(record, kind, shift):
    """A record with a planted fault: the force of both directions, or of one."""
    forward = np.gradient(record.displacement, record.time) > 0.0
    return replace(
        record, force=record.force * np.where(forward | (kind == "slip"), 1.0 + shift, 1.0)
    )


def real(options):
    planted = [("slip", shift) for shift in (0.0, -0.05, 0.05, -0.10, 0.10, -0.20, 0.20)]
    planted += [("forward only", 0.20)]
    for session in options.sessions:
        run, rows = common.calibrated(options, session), []
        files = {test.id: test.file for test in run.manifest.settings.test}
        for name in list(run.tests)[: 1 if options.quick else None]:
            names = [reference for reference in run.tests if reference != name]
            reference = common.without(run, names, "quick", (1, 2))
            path = options.out / f"campaign_{run.folder.name}" / files[name]
            columns = {}
            if name.endswith("_SI"):
                columns = {"displacement": "displacement_m", "force": "force_N"}
            record = mb.read_record(path, columns=columns, actuation=f"{name.split('lb')[0]} lbf")
            for kind, shift in planted:
                (device,) = mb.accept(reference, changed(record, kind, shift))
                words = f"{kind} {100 * shift:+.0f} %" if shift else "nothing"
                row = {"record": name, "planted": words, "p": round(device.p_value, 3)}
                rows.append(row | {"verdict": device.verdict, "named": device.named})
            print(f"{name}: done", file=sys.stderr, flush=True)
        print(f"\n{session}: each test left out")
        table(rows)
        frame = pd.DataFrame(rows)
        frame["differ"], frame["rejected"] = frame["p"] < 0.05, frame["verdict"] == "rejected"
        counts = frame.groupby("planted", sort=False)[["differ", "rejected"]].sum()
        print(f"\nof {frame['record'].nunique()} records\n{counts.to_string()}\n")
    if options.quick or "2022-07" not in options.sessions:
        return
    earlier, rows = common.calibrated(options, "2022-07"), []
    for path in sorted((options.data / "brfd").glob("2023_30lb_*_1.0in.csv")):
        (device,) = mb.accept(earlier, mb.read_record(path, actuation="30 lbf"), device=path.stem)
        row = {"2023 against 2022": path.stem, "p": round(device.p_value, 3)}
        row |= {"verdict": device.verdict, "named": device.named}
        for name in (*SLIP, "energy_per_cycle"):
            row[f"{name} %"] = round(device.rows["effect"][name])
        rows.append(row)
    table(rows)


# --- wrong verdicts

FARTHEST = 3.0 * np.log1p(0.15)  # largest size of a level, three limits
GAIN = 0.02  # standard uncertainty of the gain of both load cells
DEVICES, TESTS, N = 2000, 12, 2000  # N draws
READING = 0.005  # error of a slip force that is read off a record


def stating(settings, uncertainty):
    """Settings of a campaign whose load cell has a stated uncertainty, or none."""
    force = settings.columns.force.model_copy(update={"uncertainty": uncertainty or None})
    return settings.model_copy(
        update={"columns": settings.columns.model_copy(update={"force": force})}
    )


def stating_run(uncertainty):
    """What of a run says how well the gain of its load cell is known."""
    tables = {"columns": {"force": {"name": "force_kip"}}, "test": [{"id": "a", "file": "a.csv"}]}
    settings = stating(CampaignFile.model_validate(tables), uncertainty)
    priors = SimpleNamespace(measurement={})
    return SimpleNamespace(manifest=SimpleNamespace(settings=settings), tests=("a",), priors=priors)


def mixed_model(scatter_sd):
    """The mixed model of the slip force of tests at one level, with this prior of its scatter."""
    conditions = [TestConditions(1.0, "", {})] * TESTS
    design = design_of(load_priors("mfd"), ("Fc_fwd",), conditions, {"Fc_fwd": "proportional"})
    design = replace(design, leveled=False, scatter_sd=np.array([scatter_sd]))
    precision = np.full((TESTS, 1, 1), (design.spread[0] / READING) ** 2)
    return MixedModel(design, np.zeros((TESTS, 1)), precision)


def posterior_of(values, mixed, rng):
    """Draws of the logarithm of the mean slip force, and of the scatter of one that is read."""
    choice, spread = np.array([LAW_NAMES.index("proportional")]), mixed.design.spread[0]
    mixed.y, mixed.adapted = (values / spread)[:, None], {}
    h = sample_h(mixed, choice, rng, N)
    nominals = spread * mixed.marginal(h, choice)[1].draw(rng)[:, 0]
    return nominals, np.hypot(np.exp(h[:, 0]), READING)


def gain(options):
    """A load cell that is known to 0.5 %, and reads as much wrong, or drawn from that."""
    number, uncertainty, scatter_sd = 20 if options.quick else 200, 0.005, 0.01
    mixed, rows = mixed_model(scatter_sd), []
    stated = measurement.gains_of(stating_run(uncertainty), N)
    for label in ("drawn", "0.5 % in each"):
        intervals = {"stated": [], "not stated": []}
        for seed in range(number):
            rng = np.random.default_rng(seed)
            prior = mixed.from_standard_normal(rng.standard_normal((1, mixed.dim)))
            error = uncertainty * (rng.standard_normal() if label == "drawn" else 1.0)
            sd = np.hypot(np.exp(prior[0, 0]), READING)
            nominals, _ = posterior_of(sd * rng.standard_normal(TESTS) - error, mixed, rng)
            for words, gains in (("stated", stated), ("not stated", Gains())):
                draws = gains.applied({"slip_fwd": np.exp(nominals)})["slip_fwd"]
                intervals[words].append(np.quantile(draws, [0.025, 0.975]))
        for words, pairs in intervals.items():
            lower, upper = np.transpose(pairs)
            hits = np.count_nonzero((lower <= 1.0) & (upper >= 1.0))
            row = {"error of the gain": label, "uncertainty": words, "campaigns": number}
            row |= {"mean width %": round(100 * np.mean(upper - lower), 2)}
            rows.append(row | {"hold the truth": share(hits, number)})
    print("95 % intervals of the mean slip force from twelve tests, which scatter by about 1 %")
    table(rows)


def campaign_of_its_own(rng, mixed, gains):
    """A device, judged against tests of a campaign drawn from the priors of the mixed model."""
    design = mixed.design
    spread, level = design.spread[0], rng.uniform(-FARTHEST, FARTHEST)
    scatter = np.exp(mixed.from_standard_normal(rng.standard_normal((1, mixed.dim)))[0, 0])
    tests_gain, record_gain = GAIN * rng.standard_normal(2)
    nominal = spread * design.z_sd[0] * rng.standard_normal()
    sd = np.hypot(scatter, READING)
    values = nominal + sd * rng.standard_normal(TESTS) - tests_gain
    nominals, scatters = posterior_of(values, mixed, rng)
    tests = nominals + scatters * rng.standard_normal(N)
    draws = [gains.applied({"slip_fwd": np.exp(x)}) for x in (nominals, tests)]
    device = draws[1] | {"loop": np.ones(N)}
    expected = acceptance.Expected(draws[0], device, device, None, ())
    value = float(np.exp(nominal + level + sd * rng.standard_normal() - record_gain))
    record = SimpleNamespace(columns={"force": ("", "kip"), "displacement": ("", "in")})
    group = (acceptance.ComparedRecord(record, None, {"slip_fwd": value}, expected),)
    levels = acceptance.Level.of(group, independent=True)
    return level, acceptance.judge("", group, levels, levels.p_value, LIMITS)


def risks(label, levels, devices, campaigns, names):
    """Rows of the probabilities of wrong verdicts: as stated, and as observed.

    The standard error takes the devices of one campaign for one observation.
    """
    table = pd.concat([d.rows.loc[names] for d in devices], ignore_index=True)
    beyond = np.repeat(np.abs(np.expm1(levels)) > LIMITS["slip_fwd"], len(names))
    cluster, rows = np.repeat(campaigns, len(names)), []
    for verdict, risk, wrong in (
        ("within the limit", "p_wrong_acceptance", beyond),
        ("beyond the limit", "p_wrong_rejection", ~beyond),
    ):
        judged = (table["verdict"] == verdict).to_numpy()
        stated = table.loc[judged, risk].to_numpy()
        sums = pd.Series(wrong[judged] - stated).groupby(cluster[judged]).sum()
        error, n = np.sqrt(np.sum(sums**2)) / judged.sum(), judged.sum()
        row = {"devices": label, "verdict": verdict, "number": n, "wrong": wrong[judged].sum()}
        row |= {"stated %": 100 * stated.mean(), "observed %": 100 * wrong[judged].mean()}
        row |= {"standard error %": 100 * error, "apart, se": sums.sum() / n / error}
        rows.append({k: round(v, 2) if isinstance(v, float) else v for k, v in row.items()})
    return rows


SCALED = [*SLIP, "build_up_slope", "peak_fwd", "peak_bwd", "energy_per_cycle"]
SCALED += ["effective_stiffness"]  # what a factor of the force multiplies


def devices_of_prototypes(options, count, number):
    """Levels of devices whose forces are off by a factor, the devices judged, their prototypes."""
    set_scatter()
    rng, pool = np.random.default_rng(options.seed), []
    for seed in range(1, count + 1):
        run = prototype(options.out / f"s{seed}", seed)
        settings = stating(run.manifest.settings, GAIN)
        run = replace(run, manifest=run.manifest.changed(settings=settings))
        gains = measurement.gains_of_another(run, GAIN, 2 * N)
        pool.append(comparison(run, options.out / f"s{seed}", rng, 2 * N, gains))
    levels, seeds = rng.uniform(-FARTHEST, FARTHEST, number), np.arange(number) % count
    devices = []
    for level, seed in zip(levels, seeds, strict=True):
        gain = GAIN * (rng.standard_normal() - rng.standard_normal())  # of the tests, of the record
        group, of_device = pool[seed](np.exp(level + gain) * production_test(rng, {})[2])
        devices.append(acceptance.judge("", group, of_device, of_device.p_value, LIMITS))
    return levels, devices, seeds


def guard(options):
    number = 40 if options.quick else DEVICES
    rows = []
    for label, uncertainty in (("mixed model", GAIN), ("the same, gains not stated", 0.0)):
        gains = Gains()
        if uncertainty:
            gains = measurement.gains_of_another(stating_run(uncertainty), uncertainty, N)
        rng, devices = np.random.default_rng(options.seed), []
        mixed = mixed_model(SCATTER)
        for _ in range(number):
            devices.append(campaign_of_its_own(rng, mixed, gains))
        levels, judged = zip(*devices, strict=True)
        rows += risks(label, np.array(levels), judged, np.arange(number), ["slip_fwd"])
    print(f"{number} devices, limits 15 %; two load cells, gains known to {100 * GAIN:g} % each")
    table(rows)
    count = 2 if options.quick else options.prototypes
    levels, judged, seeds = devices_of_prototypes(options, count, number)
    print(f"\n{number} devices of {count} simulated prototypes, whose tests scatter by 2 %")
    groups = {name: [name] for name in SCALED} | {"all": SCALED}
    table([r for name, names in groups.items() for r in risks(name, levels, judged, seeds, names)])


ACTIONS = {"good": good, "drift": drift, "real": real, "gain": gain, "guard": guard}


def main():
    parser = common.parser_of(__doc__, data=True, jobs=2, output="out_heldout")
    parser.add_argument("what", choices=ACTIONS)
    parser.add_argument("--prototypes", type=int, default=5)
    parser.add_argument("--sessions", nargs="+", default=["2023-04", "2022-07"])
    options = common.begin(parser)
    ACTIONS[options.what](options)


if __name__ == "__main__":
    main()
