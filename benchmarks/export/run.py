"""Is the exported step in C that of Python, and how fast is it?

    python -m benchmarks.export.run RUN [--data FOLDER] [--opensees PYTHON]

takes ten minutes. RUN is a finished three-stage run. Four tables: C against `Model.step`, 50 draws
from the priors and their laws along every record of --data and both ground motions, constant and
changing actuation, steps that change, -O0 and -O3; a step of one vector in C and in Python, and 500
draws of a storey in El Centro in C and by `respond`; the bounds of the sets at other levels of
actuation than their own, beside the data sheet; and OpenSees with the exported step beside
`respond`, where PYTHON has openseespy, at three steps. Exit status 1: C is further from Python than
1e-12 (three_stage, lugre) or 1e-9 of the peak force, or its step takes more than half a µs.
"""

from benchmarks import common  # isort: skip  (one thread, before numpy)

import argparse
import os
import subprocess
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

import mfd_bayes as mb
from mfd_bayes.applications.buildings.building import Content, building_of
from mfd_bayes.applications.buildings.dampers import Dampers
from mfd_bayes.applications.buildings.ground import read_ground
from mfd_bayes.applications.buildings.time_integration import integrate, settle
from mfd_bayes.applications.export import compiled
from mfd_bayes.applications.export.c_source import write_source
from mfd_bayes.applications.export.compiled import CompiledStep
from mfd_bayes.applications.export.sets import parameter_sets
from mfd_bayes.applications.properties.datasheet import datasheet
from mfd_bayes.evaluation.properties import properties_of
from mfd_bayes.friction.models import MODELS
from tests.export.made import built, chosen, made_sets, stepped
from tests.export.test_compiled import BARS, with_changing_steps

EXAMPLE = common.PROJECT / "examples" / "opensees" / "storey.py"
RATE, SECONDS, ALONE = 64.0, 20.0, 5
HALF_MICROSECOND = 0.5


def motions(folder):
    """Motion of every record, 20 s of it, and of the two grounds' displacements, at 64 Hz."""
    named = {}
    for path in sorted((folder / "brfd").glob("*.csv")):
        try:
            record = mb.read_record(
                path,
                columns={
                    "time": "time_s", "displacement": "displacement_in", "force": "force_kip",
                },
            )  # fmt: skip
            trace = record.trace(rate=RATE)
        except mb.MfdError:
            continue
        begin = int(np.argmax(np.abs(trace.velocity) > 0.2 * np.abs(trace.velocity).max()))
        part = slice(begin, begin + int(RATE * SECONDS))
        named[path.stem] = trace.time[part], trace.displacement[part], trace.velocity[part]
    for name, step in (("el_centro", 0.02), ("Rinaldi", 0.01)):
        ground = read_ground(folder / "ground_motions" / f"{name}.AT2", step=step, unit="g")
        t = ground.time
        # a displacement of 2 in at most: that of an oscillator of 1 s in this ground motion
        x, v, places = 0.0, 0.0, []
        for a in ground.acceleration:
            v += ground.step * (-a - 39.5 * x - 0.6 * v)
            x += ground.step * v
            places.append((x, v))
        xs, vs = 2.0 * np.array(places).T / np.abs(np.array(places)[:, 0]).max()
        rows = slice(0, int(SECONDS / ground.step))
        named[name] = t[rows], xs[rows], vs[rows]
    return named


def accuracy(folder):
    """Print the largest difference of C from Python of each model; those that are too large."""
    named, failed = motions(folder), []
    print(f"C against Model.step: {len(named)} motions of {SECONDS:g} s, 50 draws, steps that")
    print("change; largest difference over the peak force of the draw")
    print(f"{'model':12s}{'actuation':>12s}{'-O0':>12s}{'-O3':>12s}   of")
    for name in MODELS:
        sets, worst = made_sets(name, 50), {}
        steps = {}
        for level in ("-O0", "-O3"):
            compiled.FLAGS = ("-std=c99", level, "-shared", "-fPIC")
            steps[level] = CompiledStep(sets)
        parts = {"50 together": (sets, False, named)}
        if name == "backlash":  # a batch of it differs from its vectors by as much
            few = dict(list(named.items())[:: max(1, len(named) // 4)])
            parts["alone"] = (chosen(sets, range(0, 50, ALONE)), True, few)
        for label, (group, alone, these) in parts.items():
            for file, motion in these.items():
                t, x, v = with_changing_steps(*motion)
                for kind, p in (
                    ("constant", np.full(t.size, 1.0)),
                    ("changing", 1.6 + 1.6 * np.sin(1.3 * t)),
                ):
                    expected = stepped(group, t, x, v, p, alone=alone)
                    peak = np.abs(expected).max(axis=1)
                    for level, step in steps.items():
                        force = np.stack([step.force(row, t, x, v, p) for row in group.names])
                        error = (np.abs(force - expected).max(axis=1) / peak).max()
                        key = label, kind, level
                        worst[key] = max(worst.get(key, (0.0, "")), (float(error), file))
            for kind in ("constant", "changing"):
                pair = [worst[label, kind, level] for level in ("-O0", "-O3")]
                cells = "".join(f"{error:12.1e}" for error, _ in pair)
                print(f"{name:12s}{kind:>12s}{cells}   {label}; {pair[1][1]}", flush=True)
                judged = label == "alone" or name != "backlash"
                if judged and max(pair)[0] > BARS[name]:
                    failed.append(f"{name}: {max(pair)[0]:.1e} of the peak off Python")
    compiled.FLAGS = ("-std=c99", "-O2", "-shared", "-fPIC")
    return failed


def best_of(action, repeats=5):
    """Least processor time of an action, s."""
    times = []
    for _ in range(repeats):
        begin = time.process_time()
        action()
        times.append(time.process_time() - begin)
    return min(times)


def cost():
    """Print the time of a step of one vector; those in C that take too long."""
    failed = []
    print("\nA step of one vector, processor µs (least of five); a sine, 200 samples a cycle")
    print(f"{'model':12s}{'C':>12s}{'by ctypes':>12s}{'Python':>12s}{'Python/C':>10s}")
    t = np.arange(4000) * 0.005
    x, v, p = np.sin(2 * np.pi * t), 2 * np.pi * np.cos(2 * np.pi * t), np.ones(t.size)
    for name in MODELS:
        sets = made_sets(name, 1)
        step = CompiledStep(sets)
        in_c = best_of(lambda step=step: [step.force("1", t, x, v, p) for _ in range(10)]) / 10

        def by_ctypes(step=step):
            state = step.start("1")
            for k in range(400):
                _, state = step.step(state, x[k], v[k], 0.005, 1.0)

        def in_python(sets=sets):
            state = sets.model.start(sets.theta, sets.start)
            for k in range(400):
                _, state = sets.model.step(state, x[k], v[k], 0.005)

        each = in_c / t.size, best_of(by_ctypes) / 400, best_of(in_python) / 400
        cells = "".join(f"{1e6 * value:12.3f}" for value in each)
        print(f"{name:12s}{cells}{each[2] / each[0]:10.0f}", flush=True)
        if 1e6 * each[0] > HALF_MICROSECOND:
            failed.append(f"{name}: {1e6 * each[0]:.2f} µs a step")
    return failed


def storey():
    """The storey of the example."""
    content = {
        "storey": [{"weight": "20 kip", "stiffness": "8 kip/in"}],
        "damper": [{"storey": 1, "actuation": "1 ksi"}],
        "building": {"damping": {"kind": "modal", "ratio": 0.02}},
    }
    return building_of(Content.model_validate(content), Path("storey"))


def draws_of_a_storey(run, folder):
    """Print the time of 500 draws of a storey, and how far their drifts are apart."""
    ground = read_ground(folder / "ground_motions" / "el_centro.AT2", step=0.02, unit="g")
    building = storey()
    sets = parameter_sets(run, 1.0, 500)
    only = chosen(sets, range(3, 503))
    dampers = Dampers(only.model, only.theta[:, None], only.start[:, None], np.full((500, 1), 1.4))
    begin = time.process_time()
    ours = settle(building, ground, dampers)
    of_dampers = time.process_time() - begin
    begin = time.process_time()
    whole = mb.respond(run, building, ground, draws=500)
    of_respond = time.process_time() - begin
    m, k, c = (float(a[0, 0]) for a in (building.mass, building.stiffness, building.damping))
    print("\n500 draws of a storey in El Centro (1559 samples of 0.02 s)")
    print(f"{'':44s}{'processor s':>12s}{'median drift, in':>18s}{'largest apart':>15s}")
    print(f"{'respond (discrepancy, bounds, references)':44s}{of_respond:12.1f}"
          f"{np.median(whole.drift[:, 0, 0]):18.4f}")  # fmt: skip
    print(f"{'its integration, these 500 dampers alone':44s}{of_dampers:12.1f}"
          f"{np.median(ours.drift[:, 0, 0]):18.4f}")  # fmt: skip
    with tempfile.TemporaryDirectory() as name:
        text = (Path(__file__).parent / "storey.c").read_text()
        program = built(Path(name), only, text, "-O3")
        for parts in (4, 8, 16):
            step = ground.step / parts
            t = np.arange(0.0, ground.time[-1] + 0.5 * step, step)
            values = np.interp(t, ground.time, ground.acceleration)
            words = [program, m, k, c, step, 1.0]
            ended = subprocess.run(
                [*map(str, words)],
                input="\n".join(map(repr, values.tolist())) + "\nx",
                capture_output=True,
                text=True,
                check=True,
            )
            *drifts, seconds, steps = (float(word) for word in ended.stdout.split())
            apart = np.abs(np.array(drifts) / ours.drift[:, 0, 0] - 1.0)
            label = f"C, Newmark, {1000 * step:g} ms ({steps / 1e6:.0f} million steps)"
            print(f"{label:44s}{seconds:12.2f}{np.median(drifts):18.4f}{apart.max():15.1%}")


def fmu_at_equal_steps(run):
    """Print how far a storey of `respond` with the FMU is from that without it, at equal steps."""
    import fmpy

    from mfd_bayes.applications.buildings import time_integration
    from mfd_bayes.applications.export.fmu import write_fmu
    from tests.export.test_fmu import FmuDevices, Slave
    from tests.export.test_fmu import storey as shaken

    sets = parameter_sets(run, 1.0, 10)
    print("\nA storey of respond with the FMU as its damper; difference of the drift")
    print(f"{'step, s':>8s}{'FMI 2.0':>12s}{'FMI 3.0':>12s}   over the drift")
    original = time_integration.Devices.__dict__["at_rest"]
    with tempfile.TemporaryDirectory() as name:
        folders = {}
        for fmi in ("2.0", "3.0"):
            write_fmu(run, sets, Path(name) / f"{fmi}.fmu", fmi)
            folders[fmi] = fmpy.extract(str(Path(name) / f"{fmi}.fmu"), str(Path(name) / fmi))
        for step in (0.02, 0.01, 0.005):
            building, ground = shaken(step)
            theta, start = sets.theta[0][None, None], sets.start[:1][None]
            dampers = Dampers(sets.model, theta, start, np.full((1, 1), 1.4))
            ours, cells = integrate(building, ground, dampers, 1e9), ""
            for fmi in folders:

                def at_rest(building, dampers, way, fmi=fmi):
                    slave = Slave(folders[fmi])
                    force = slave.start("nominal", -1 if way[0] < 0 else 1)
                    return FmuDevices(slave, slave.get_state(), np.array([[force]]))

                time_integration.Devices.at_rest = staticmethod(at_rest)
                theirs = integrate(building, ground, dampers, 1e9)
                time_integration.Devices.at_rest = original
                cells += f"{abs(theirs.drift[0, 0, 0] / ours.drift[0, 0, 0] - 1.0):12.1e}"
            print(f"{step:8g}{cells}", flush=True)


def without_iteration(run, folder):
    """Print the drift by a master that takes the FMU's force as it comes, a step late."""
    import fmpy

    from mfd_bayes.applications.export.fmu import write_fmu
    from tests.export.test_fmu import Slave

    sets, building = parameter_sets(run, 1.0, 10), storey()
    ground = read_ground(folder / "ground_motions" / "el_centro.AT2", step=0.02, unit="g")
    theta, start = sets.theta[:1, None], sets.start[:1, None]
    dampers = Dampers(sets.model, theta, start, np.full((1, 1), 1.4))
    ours = float(settle(building, ground, dampers, 0.0003).drift[0, 0, 0])
    m, k, c = (float(a[0, 0]) for a in (building.mass, building.stiffness, building.damping))
    print("\nA storey with the FMU, set nominal, in El Centro: largest drift, in")
    print(f"{'master':28s}{'drift':>10s}{'off':>9s}")
    print(f"{'iterated: respond':28s}{ours:10.4f}")
    with tempfile.TemporaryDirectory() as name:
        write_fmu(run, sets, Path(name) / "d.fmu", "2.0")
        slave_folder = fmpy.extract(str(Path(name) / "d.fmu"), str(Path(name) / "d"))
        for parts in (4, 20, 100):
            h = ground.step / parts
            t = np.arange(0.0, ground.time[-1], h)
            shaking = np.interp(t, ground.time, ground.acceleration)
            slave = Slave(slave_folder)
            rest = force = slave.start("nominal", -1 if shaking[1] > 0 else 1)
            x = v = peak = 0.0
            a = -shaking[0]
            for acceleration in shaking[1:]:
                late = slave.step(x, v, h)  # both take the step at once
                load = -m * acceleration - (force - rest) - c * (v + 0.5 * h * a)
                after = (load - k * (x + h * v + 0.25 * h * h * a)) / (
                    m + 0.5 * h * c + 0.25 * h * h * k
                )
                x += h * v + 0.25 * h * h * (a + after)
                v += 0.5 * h * (a + after)
                a, force, peak = after, late, max(peak, abs(x))
            print(f"{f'step by step, {1000 * h:g} ms':28s}{peak:10.4f}{peak / ours - 1:9.2%}")


def bounds_elsewhere(run):
    """Print the sets' slip forces at other levels than their own, over those of the data sheet."""
    rows = datasheet(run).rows
    of_slip = rows[(rows["quantity"] == "slip_force") & rows["tested"]]
    levels = sorted({float(p) for p in of_slip["actuation"] if p > 0})
    own = levels[len(levels) // 2]
    sets = chosen(parameter_sets(run, own, 10), range(3))
    traces = {name: test.trace for name, test in run.tests.items()}
    print(f"\nSlip forces of the sets made at {own:g} {run.actuation_unit}, over the data sheet's")
    print(f"{'level':>8s}{'nominal':>18s}{'lower':>18s}{'upper':>18s}   forward, backward")
    for level in levels:
        name = next((n for n, t in traces.items() if abs(t.reference_actuation - level) < 1e-9), "")
        if not name:  # a level of tests that were held out
            continue
        trace = replace(traces[name], force=None)
        scales = {k: f[:, None] * np.ones(trace.samples) for k, f in sets.factors(level).items()}
        force = sets.model.force(sets.theta, trace, sets.start, scales=scales)
        values = properties_of(trace, force)
        there = of_slip[np.isclose(of_slip["actuation"], level)]
        first = there[there["condition"] == there["condition"].iloc[0]]
        cells = ""
        for row, kind in enumerate(sets.names):
            pair = [
                values[f"slip_{side}"][row]
                / float(first[first["direction"] == direction][kind].iloc[0])
                for side, direction in (("fwd", "forward"), ("bwd", "backward"))
            ]
            cells += f"{pair[0]:10.3f}{pair[1]:8.3f}"
        print(f"{level:8g}{cells}")


def beside_opensees(run, folder, python):
    """Print the drift of the example in OpenSees beside that of `respond`'s integration."""
    ground = folder / "ground_motions" / "el_centro.AT2"
    sets = parameter_sets(run, 1.0, 10)
    theta, start = sets.theta[:3, None], sets.start[:3, None]
    dampers = Dampers(sets.model, theta, start, np.full((3, 1), 1.4))
    read = read_ground(ground, step=0.02, unit="g")
    print("\nThe storey of examples/opensees in El Centro: largest drift, in")
    print(f"{'':28s}{'nominal':>10s}{'lower':>10s}{'upper':>10s}")
    for tolerance in (0.01, 0.0003):
        drift = settle(storey(), read, dampers, tolerance).drift[:, 0, 0]
        cells = "".join(f"{value:10.5f}" for value in drift)
        print(f"{f'respond, tolerance {tolerance:g}':28s}{cells}")
    with tempfile.TemporaryDirectory() as name:
        write_source(run, sets, Path(name))
        for parts in (5, 20, 80):
            words = [python, EXAMPLE, name, ground, 0.02, "--parts", parts]
            ended = subprocess.run([*map(str, words)], capture_output=True, text=True, check=True)
            lines = [line.split() for line in ended.stdout.splitlines()]
            values = [float(line[1]) for line in lines if len(line) == 2]
            cells = "".join(f"{value:10.5f}" for value in values[:3])
            print(f"{f'OpenSees, steps of {20 / parts:g} ms':28s}{cells}", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("run", type=Path)
    default = os.environ.get("MFD_BAYES_DATA", common.PROJECT.parent / "shared" / "data")
    parser.add_argument("--data", type=Path, default=Path(default))
    parser.add_argument("--opensees", default="")
    options = parser.parse_args()
    run = mb.open_run(options.run)
    failed = cost()
    draws_of_a_storey(run, options.data)
    fmu_at_equal_steps(run)
    without_iteration(run, options.data)
    bounds_elsewhere(run)
    if options.opensees:
        beside_opensees(run, options.data, options.opensees)
    print()
    failed += accuracy(options.data)
    for line in failed:
        print(f"FAILED {line}")
    raise SystemExit(bool(failed))


if __name__ == "__main__":
    main()
