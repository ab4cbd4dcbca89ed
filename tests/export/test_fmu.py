"""The FMU: valid by FMPy, its forces, its state, a storey with it, and what it refuses."""

import subprocess
import zipfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from mfd_bayes import open_run
from mfd_bayes.applications.buildings import time_integration
from mfd_bayes.applications.buildings.building import Content, building_of
from mfd_bayes.applications.buildings.dampers import Dampers
from mfd_bayes.applications.buildings.ground import Ground
from mfd_bayes.applications.export.compiled import compiler
from mfd_bayes.applications.export.sets import parameter_sets
from tests.command_line import refusal, said
from tests.export.made import WARNINGS, needs_compiler

fmpy = pytest.importorskip("fmpy", reason='needs the extra "fmu": pip install ".[fmu]"')
build_platform_binary = pytest.importorskip("fmpy.build").build_platform_binary
FMU2Slave = pytest.importorskip("fmpy.fmi2").FMU2Slave
FMU3Slave = pytest.importorskip("fmpy.fmi3").FMU3Slave
validate_fmu = pytest.importorskip("fmpy.validation").validate_fmu

INCH, KIP, KSI = 0.0254, 4448.2216152605, 6894757.293168361
VERSIONS = ("2.0", "3.0")
ROW = {"nominal": 0, "upper": 2, "7": 9}
MASTER = Path(__file__).parent / "master.c"

pytestmark = needs_compiler


@pytest.fixture(scope="module")
def files(finished_run, tmp_path_factory):
    """An FMU of each version, at 1000 psi."""
    folder = tmp_path_factory.mktemp("fmu")
    for fmi in VERSIONS:
        words = ("--to", "fmu", "--fmi", fmi, "--draws", 10, "--actuation", "1000 psi")
        text = said("export", finished_run.out, *words, "-o", folder / f"{fmi}.fmu")
        assert f"FMI {fmi} for co-simulation, in SI units, with sources and a binary" in text
    return {fmi: str(folder / f"{fmi}.fmu") for fmi in VERSIONS}


@pytest.fixture(scope="module")
def folders(files, tmp_path_factory):
    """The same, unpacked: a library that is loaded must not be written again."""
    folder = tmp_path_factory.mktemp("unpacked")
    return {fmi: fmpy.extract(file, str(folder / fmi)) for fmi, file in files.items()}


@pytest.fixture(scope="module")
def sets(finished_run):
    return parameter_sets(open_run(finished_run.out), 1.0, 10)


class Slave:
    """An FMU that runs, in kip, in, s, by either version of the standard."""

    def __init__(self, folder):
        description = fmpy.read_model_description(folder)
        fmi2 = description.fmiVersion == "2.0"
        kind = FMU2Slave if fmi2 else FMU3Slave
        token = description.guid if fmi2 else description.instantiationToken
        self.fmu = kind(
            guid=token,
            unzipDirectory=folder,
            modelIdentifier="damper",
            instanceName="one",
        )
        self.fmu.instantiate()
        f = self.fmu
        self.set_real, self.get_real = (
            (f.setReal, f.getReal) if fmi2 else (f.setFloat64, f.getFloat64)
        )
        self.set_integer = f.setInteger if fmi2 else f.setInt32
        self.get_state, self.set_state, self.serialize, self.deserialize = (
            (f.getFMUstate, f.setFMUstate, f.serializeFMUstate, f.deSerializeFMUstate)
            if fmi2
            else (f.getFMUState, f.setFMUState, f.serializeFMUState, f.deserializeFMUState)
        )
        self.fmi2 = fmi2

    def start(self, name="nominal", direction=0, x=0.0, v=0.0, p=1.0):
        self.fmu.setString([7], [name])
        self.set_integer([8], [direction])
        self.put(x, v, p)
        if self.fmi2:
            self.fmu.setupExperiment(startTime=0.0)
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()
        return self.force

    def put(self, x, v, p=1.0):
        self.set_real([0, 1, 2], [x * INCH, v * INCH, p * KSI])

    def step(self, x, v, size, p=1.0):
        self.put(x, v, p)
        self.fmu.doStep(0.0, size)
        return self.force

    @property
    def force(self):
        return self.get_real([3])[0] / KIP


@pytest.mark.parametrize("fmi", VERSIONS)
def test_fmpy_validates_it(files, fmi, tmp_path):
    assert validate_fmu(files[fmi]) == []
    description = fmpy.read_model_description(files[fmi])
    variables = {v.name: v for v in description.modelVariables}
    assert variables["force"].unit == "N"
    assert variables["actuation"].unit == "Pa"
    assert float(variables["actuation"].start) == pytest.approx(1.0 * KSI)
    assert "500 to 1500 psi" in variables["actuation"].description
    # an output that is left out of the structure is seen
    folder = fmpy.extract(files[fmi], tmp_path)
    path = Path(folder) / "modelDescription.xml"
    name = "modelDescription"
    assert path.stem == name
    lines = path.read_text().splitlines()
    without = [x for x in lines if '<Unknown index="4"/>' not in x and "<Output value" not in x]
    path.write_text("\n".join(without))
    assert validate_fmu(str(folder))


@pytest.mark.parametrize("fmi", VERSIONS)
def test_fmpy_simulates_the_forces_of_the_model(files, sets, fmi):
    time = np.arange(0.0, 3.0, 0.01)
    x, v = np.sin(3 * time), 3 * np.cos(3 * time)
    p = 1.0 + 0.4 * np.sin(time)
    kind = [(n, float) for n in ("time", "displacement", "velocity", "actuation")]
    motion = np.array(list(zip(time, INCH * x, INCH * v, KSI * p, strict=True)), dtype=kind)
    for name, row in ROW.items():
        result = fmpy.simulate_fmu(
            files[fmi],
            stop_time=time[-1],
            step_size=0.01,
            output_interval=0.01,
            input=motion,
            start_values={"set": name, "offset": 100.0},
        )
        model, force = sets.model, []
        state = model.start(sets.theta[[row]], sets.start[[row]])
        # the inputs of a time belong to the end of the step that begins there
        for k in [0, *range(time.size - 1)]:
            scales = {n: values[[row]] for n, values in sets.factors(p[k]).items()}
            value, state = model.step(state, x[k], v[k], 0.01, scales=scales)
            force.append(value[0])
        expected = np.array(force) * KIP + 100.0
        np.testing.assert_allclose(result["force"], expected, rtol=0, atol=1e-9 * KIP)
        work = result["dissipated_energy"]
        power = 0.5 * (expected[1:] + expected[:-1] - 200.0) * np.diff(INCH * x[:-1], prepend=0.0)
        assert work[-1] == pytest.approx(power.sum(), rel=1e-6)
        width = (sets.theta[row, 9] + sets.theta[row, 10]) * INCH
        assert result["gap_travel"].max() == pytest.approx(width, rel=1e-12)


@pytest.mark.parametrize("fmi", VERSIONS)
def test_a_state_that_is_restored_gives_the_same_bits(folders, fmi):
    def forces(slave, begin=40):
        """Of the steps from `begin` on."""
        return [slave.step(np.sin(k / 9), 11 * np.cos(k / 9), 0.01) for k in range(begin, 80)]

    slave = Slave(folders[fmi])
    slave.start("upper", 1)
    for k in range(40):
        slave.step(np.sin(k / 9), 11 * np.cos(k / 9), 0.01)
    state = slave.get_state()
    content = slave.serialize(state)
    first = forces(slave)
    assert forces(slave) != first
    slave.set_state(state)
    assert forces(slave) == first
    other = Slave(folders[fmi])
    other.start("lower", -1)
    other.step(0.4, 1.0, 0.01)
    other.set_state(other.deserialize(content))
    assert forces(other) == first


@dataclass(frozen=True)
class FmuDevices:
    """The device of one storey as `time_integration.Devices`, but stepped by an FMU."""

    slave: Slave
    state: object
    force: np.ndarray

    def step(self, travel, velocity, size, time):
        self.slave.set_state(self.state)
        force = self.slave.step(float(travel[0, 0]), float(velocity[0, 0]), size)
        return replace(self, state=self.slave.get_state(), force=np.array([[force]]))

    def chosen(self, rows):
        return self

    def replaced(self, rows, other):
        return other


def storey(step):
    """A storey of 20 kip, and 5 s of a ground motion that grows and decays."""
    content = {
        "storey": [{"weight": "20 kip", "stiffness": "8 kip/in"}],
        "damper": [{"storey": 1, "actuation": "1 ksi"}],
    }
    time = np.arange(0.0, 5.0, step)
    shaking = 150.0 * np.sin(9 * time + 2.0 * time**1.5) * np.exp(-((time - 2.5) ** 2))
    return building_of(Content.model_validate(content), Path("x")), Ground("g", step, shaking)


@pytest.mark.parametrize("fmi", VERSIONS)
@pytest.mark.parametrize("step", [0.02, 0.01, 0.005])
def test_a_storey_of_respond_has_the_same_drift_with_the_fmu(folders, sets, fmi, step, monkeypatch):
    """At equal steps: none is halved."""
    building, ground = storey(step)
    theta, start = sets.theta[0][None, None], sets.start[:1][None]
    dampers = Dampers(sets.model, theta, start, np.full((1, 1), 1.4))
    ours = time_integration.integrate(building, ground, dampers, 1e9)

    def at_rest(building, dampers, way):
        slave = Slave(folders[fmi])
        force = slave.start("nominal", -1 if way[0] < 0 else 1)
        return FmuDevices(slave, slave.get_state(), np.array([[force]]))

    monkeypatch.setattr(time_integration.Devices, "at_rest", at_rest)
    with_fmu = time_integration.integrate(building, ground, dampers, 1e9)
    assert with_fmu.steps[0, 0] == step
    assert ours.drift[0, 0, 0] > 0.5
    difference = np.abs(with_fmu.histories[0] - ours.histories[0]).max()
    assert difference <= 1e-6 * ours.drift[0, 0, 0]
    np.testing.assert_allclose(with_fmu.drift, ours.drift, rtol=1e-6)
    np.testing.assert_allclose(with_fmu.energy, ours.energy, rtol=1e-6)


def test_a_master_in_c_steps_a_storey_without_python(folders, sets, tmp_path):
    """As the same scheme with `Model.step`; a larger step gives another drift."""
    folder = Path(folders["2.0"])
    flags = [*WARNINGS, "-Wno-pedantic", "-O1"]
    program = tmp_path / "master"
    subprocess.run([*compiler(), *flags, MASTER, "-lm", "-ldl", "-o", program], check=True)
    token = fmpy.read_model_description(str(folder)).guid
    drifts = []
    for step in (0.01, 0.005):
        building, ground = storey(step)
        m, k, c = (float(a[0, 0]) for a in (building.mass, building.stiffness, building.damping))
        unit = KIP / INCH
        words = [str(folder / "binaries/linux64/damper.so"), token, "nominal", 1.0 * KSI]
        words += [m * unit, k * unit, c * unit, step]
        ended = subprocess.run(
            [str(program), *map(str, words)],
            input="\n".join(repr(float(a) * INCH) for a in ground.acceleration),
            capture_output=True,
            text=True,
            check=True,
            env={},
        )
        drifts.append(float(ended.stdout) / INCH)
        assert drifts[-1] == pytest.approx(newmark(sets, m, k, c, ground), rel=1e-6)
    assert drifts[0] != pytest.approx(drifts[1], rel=1e-5)


def newmark(sets, m, k, c, ground):
    """Largest displacement by the scheme of master.c, in, with `Model.step`."""
    model, h, shaking = sets.model, ground.step, ground.acceleration
    direction = -1 if shaking[0] > 0 else 1
    state = model.start(sets.theta[:1], sets.start[:1], direction=direction)
    rest, state = model.step(state, 0.0, 0.0, 0.0)
    x, v, a, peak, force = 0.0, 0.0, -shaking[0], 0.0, rest[0]
    for acceleration in shaking[1:]:

        def moved(push, x=x, v=v, a=a, load=-m * acceleration):
            load = load - (push - rest[0]) - c * (v + 0.5 * h * a)
            after = (load - k * (x + h * v + 0.25 * h * h * a)) / (
                m + 0.5 * h * c + 0.25 * h * h * k
            )
            return x + h * v + 0.25 * h * h * (a + after), v + 0.5 * h * (a + after), after

        pushes, offs = [force], []
        while True:
            x1, v1, a1 = moved(pushes[-1])
            answer, trial = model.step(state, x1, v1, h)
            offs.append(answer[0] - pushes[-1])
            if abs(offs[-1]) <= 1e-12 * (1 + abs(answer[0])) or len(offs) == 60:
                break
            if len(offs) > 1 and offs[-1] != offs[-2]:
                slope = (pushes[-1] - pushes[-2]) / (offs[-1] - offs[-2])
                pushes.append(pushes[-1] - offs[-1] * slope)
            else:
                pushes.append(pushes[-1] + 0.5 * offs[-1])
        force, state, x, v, a = answer[0], trial, x1, v1, a1
        peak = max(peak, abs(x))
    return peak


@pytest.mark.parametrize("fmi", VERSIONS)
def test_what_it_refuses(folders, fmi):
    slave = Slave(folders[fmi])
    with pytest.raises(Exception, match=r"[sS]tatus 3|fmi\dError|failed"):
        slave.fmu.setString([7], ["median"])
    before = slave.start("nominal")
    for x, v, size, p in ((0.1, 1.0, 0.01, 9.0), (0.1, 1.0, 0.01, -0.1), (0.1, np.nan, 0.01, 1.0),
                          (0.1, 1.0, 0.0, 1.0)):  # fmt: skip
        with pytest.raises(Exception, match=r"[sS]tatus 3|fmi\dError|failed"):
            slave.step(x, v, size, p)
        assert slave.force == before
    assert slave.step(0.1, 1.0, 0.01, 2.0) != before  # outside of the tests, not far: a warning
    with pytest.raises(Exception, match=r"[sS]tatus 3|fmi\dError|failed"):
        slave.fmu.setString([7], ["upper"])  # it has begun


def test_without_a_compiler_it_has_sources_which_fmpy_compiles(finished_run, tmp_path, monkeypatch):
    file = tmp_path / "damper.fmu"
    with monkeypatch.context() as patch:
        patch.setattr("mfd_bayes.applications.export.fmu.compiler", list)
        words = ("--to", "fmu", "--draws", 10, "--actuation", "1000 psi", "-o", file)
        text = said("export", finished_run.out, *words)
    assert "with sources alone, since no compiler of C is found here" in text
    with zipfile.ZipFile(file) as archive:
        assert not [name for name in archive.namelist() if name.startswith("binaries")]
    assert validate_fmu(str(file)) == []
    folder = fmpy.extract(str(file), tmp_path / "out")
    (tmp_path / "build").mkdir()
    build_platform_binary(folder, tmp_path / "build")
    slave = Slave(folder)
    slave.start("upper", 1)
    assert slave.step(0.3, 3.0, 0.05) > 0.1
    assert "exists" in refusal("export", finished_run.out, *words)
