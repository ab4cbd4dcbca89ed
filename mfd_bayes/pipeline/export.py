"""A run for other programs: samples for quoFEM, OpenSees and CSV, and a server.

The server answers by the protocol of UM-Bridge (Seelinger et al., 2023). It is small, so that the
standard library answers it: for this machine alone, in valid JSON, and with a sentence where a
request is malformed. `umbridge.serve_models` listens on every interface, answers NaN, and ends in
tracebacks and empty answers there.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from mfd_bayes.calibration.posterior import Posterior, units
from mfd_bayes.errors import CampaignError, MfdError, StoreError, why_invalid
from mfd_bayes.friction.bouc_wen import BoucWen
from mfd_bayes.friction.model import Model
from mfd_bayes.friction.models import find_model
from mfd_bayes.records.record import read_record
from mfd_bayes.records.trace import Trace, parse_sine
from mfd_bayes.response.building import Building, Device, Limits, draw_dampers
from mfd_bayes.runs.folder import POPULATION, check_folder
from mfd_bayes.runs.run import Run, open_run
from mfd_bayes.runs.tested_range import Span, departures, far_sentences
from mfd_bayes.store.files import read_json, remove_file, write_json, write_text
from mfd_bayes.units import parse_actuation

Array = NDArray[np.float64]

FITS = 24  # draws to which a material is fitted
ABOUT = "about.json"
_MADE_BY = "mfd_bayes export"


@dataclass(frozen=True)
class Export:
    """What is to be written; the options of the command."""

    to: str
    folder: Path
    actuation: str = ""
    draws: int = 1000
    seed: int = 1
    force: bool = False
    extrapolate: bool = False
    trust_model: bool = False


def export(out: Path, request: Export) -> tuple[list[str], list[str]]:
    """Write the samples of a new device; what was written, and reasons to trust it less."""
    folder = request.folder
    check_folder(folder, force=request.force)
    run = open_run(out, trust=request.trust_model)
    level = float(np.median([t.trace.reference_actuation for t in run.tests.values()]))
    actuated = run.manifest.axes.actuated
    if request.actuation:
        if not actuated:
            raise CampaignError("--actuation: the campaign's tests have none; leave it out")
        level = run.level_of(request.actuation)
    reach = [Span("actuation", run.actuation_unit, level, level)] if actuated else []
    outside = departures(run.tested, reach)
    far = far_sentences(outside, run.system)
    if far and not request.extrapolate:
        raise CampaignError(f"{far}; give --extrapolate to export it all the same")
    remarks = [departure.sentence(run.system) for departure in outside]
    units, samples = _samples(run, level, request)
    about: dict[str, object] = {
        "made_by": _MADE_BY,
        **({"actuation": {"value": level, "unit": run.actuation_unit}} if actuated else {}),
        "variables": units,
        "draws": request.draws,
        "seed": request.seed,
        "kind": "new_test",
        "population_sha256": (run.manifest.files or {}).get(POPULATION),
    } | ({"remarks": remarks} if remarks else {})
    about = _without_others(folder, about)
    if request.to == "csv":
        sentences = _write_csv(folder, units, samples)
    elif request.to == "quofem":
        sentences = _write_quofem(folder, list(units), samples)
    else:
        sentences = _write_opensees(folder, run, samples[:FITS], about)
    write_json(folder / ABOUT, about)
    return sentences, remarks


def _samples(run: Run, level: float, request: Export) -> tuple[dict[str, str], Array]:
    """Units of a new device's parameters, and start in its gap, by name, and their draws (n, m)."""
    model = next(iter(run.tests.values())).posterior.model
    matrix, vector = np.ones((1, 1)), np.ones(1)
    building = Building(
        *("one device", matrix, matrix, matrix, vector, matrix, vector, vector, vector),
        (Device("device", 1, 0, level, run.actuation_unit),),
        Limits(),
    )
    dampers = draw_dampers(run.population, model, building, draws=request.draws, seed=request.seed)
    known = {q.name: q.unit for q in model.quantities}
    units = {name: known.get(name, "1") for name in model.parameters}
    if not model.has_gap:
        return units, dampers.theta[:, 0]
    return units | {"start": "1"}, np.column_stack([dampers.theta[:, 0], dampers.start[:, 0]])


def _without_others(folder: Path, about: dict[str, object]) -> dict[str, object]:
    """What is said about the samples, of all their forms in the folder.

    Where an earlier export is of other samples, its files are removed: nothing would say what they
    are.
    """
    try:
        earlier = read_json(folder / ABOUT)
    except StoreError:  # there is none
        return about
    if earlier.get("made_by") != _MADE_BY:
        return about
    if all(earlier.get(key) == value for key, value in about.items()):
        of_fits = ("misfit", "best", "amplitude_in")
        return about | {key: earlier[key] for key in of_fits if key in earlier}
    names = ["samples.csv", "randomVariables.json", "dakotaTab.out"]
    for key, kind in (("variables", "txt"), ("misfit", "tcl")):
        words = earlier.get(key)
        if isinstance(words, dict):
            names += [f"{word}.{kind}" for word in words if re.fullmatch(r"\w+", word)]
    for name in names:
        remove_file(folder / name)
    return about


def _write_csv(folder: Path, units: dict[str, str], samples: Array) -> list[str]:
    """One table with a header."""
    head = [
        name if unit == "1" else f"{name}_{unit.replace('*', '_').replace('/', '_per_')}"
        for name, unit in units.items()
    ]
    lines = [",".join(head), *(",".join(f"{v:.9g}" for v in row) for row in samples)]
    write_text(folder / "samples.csv", "\n".join(lines) + "\n")
    return [f"{len(samples)} joint samples of {len(units)} variables: {folder / 'samples.csv'}"]


def _write_quofem(folder: Path, names: list[str], samples: Array) -> list[str]:
    """A column per variable without a header, the group of all, and dakotaTab.out."""
    for name, column in zip(names, samples.T, strict=True):
        write_text(folder / f"{name}.txt", "\n".join(f"{v:.12g}" for v in column) + "\n")
    kind = {"variableClass": "Uncertain", "inputType": "Dataset", "distribution": "Discrete"}
    variables = [
        {"name": name, **kind, "refCount": 1, "value": f"RV.{name}", "dataDir": f"{name}.txt"}
        for name in names
    ]
    group = [f"{{{','.join(names)}}}"]
    write_json(
        folder / "randomVariables.json", {"randomVariables": variables, "RVdataGroup": group}
    )
    lines = ["%eval_id interface " + " ".join(names)]
    for i, row in enumerate(samples, start=1):
        lines.append(f"{i} NO_ID " + " ".join(f"{v:.12g}" for v in row))
    write_text(folder / "dakotaTab.out", "\n".join(lines) + "\n")
    return [
        f"{len(samples)} joint samples of {len(names)} variables: a file each in {folder}",
        f"their group, which keeps the correlation: {folder / 'randomVariables.json'}; "
        f"all in one: {folder / 'dakotaTab.out'}",
    ]


def _write_opensees(folder: Path, run: Run, samples: Array, about: dict[str, object]) -> list[str]:
    """Materials fitted to each draw's loops; their misfits are added to `about`."""
    model = next(iter(run.tests.values())).posterior.model
    stroke = max((s.highest for s in run.tested if s.name == "stroke"), default=2.0)
    theta, start = samples[:, : len(model.parameters)], samples[:, -1]
    fits = equivalents(model, theta, start, 0.5 * stroke)
    sentences = []
    for name, (commands, misfit) in fits.items():
        lines = [f"# {name} fitted to the predicted loops of draw i; kip, in, s", *commands]
        write_text(folder / f"{name}.tcl", "\n".join(lines) + "\n")
        low, middle, high = np.quantile(misfit, [0.05, 0.5, 0.95])
        sentences.append(
            f"{name}: misfit (rms over the rms force of the predicted loop) {100 * middle:.3g} % "
            f"({100 * low:.3g} to {100 * high:.3g} %) over {misfit.size} draws: "
            f"{folder / (name + '.tcl')}"
        )
    best = min(fits, key=lambda name: float(np.median(fits[name][1])))
    about["misfit"] = {name: misfit.tolist() for name, (_, misfit) in fits.items()}
    about["best"] = best
    about["amplitude_in"] = 0.5 * stroke
    return [
        *sentences,
        f"the best of them: {best}; a gap and its retracing cannot be modelled by one material",
    ]


# --- the materials of OpenSees that come closest to the loops of a device

SAMPLES = 400
CYCLES = (0.25, 0.5, 1.0, 1.0)
"""Amplitudes of the cycles to which materials are fitted, over the largest."""

PERIOD = 4.0  # of a cycle, s


def equivalents(
    model: Model, theta: Array, start: Array, amplitude: float
) -> dict[str, tuple[list[str], Array]]:
    """BoucWen and ElasticPP of OpenSees, fitted to the loops of each draw (n, p) by least squares.

    By name, a command for each draw, and the misfits, (n,): root mean square of the difference over
    that of the predicted force. The motion is four cycles of growing amplitude, up to this one, in.
    """
    time = np.linspace(0.0, PERIOD * len(CYCLES), SAMPLES + 1)
    cycle = np.minimum((time / PERIOD).astype(int), len(CYCLES) - 1)
    x = amplitude * np.array(CYCLES)[cycle] * np.sin(2.0 * np.pi / PERIOD * time)
    trace = Trace.from_arrays(time, x)
    force = model.force(theta, trace, start) if model.has_gap else model.force(theta, trace)
    materials = {}
    for name, fit in (("BoucWen", _bouc_wen), ("ElasticPP", _elastic_plastic)):
        commands, misfit = [], []
        for tag, own in enumerate(force, start=1):
            slip = float(np.quantile(np.abs(own), 0.8))
            stiffness = slip / (0.1 * float(np.ptp(x)))
            command, fitted = fit(tag, trace, own, np.log([stiffness, slip]))
            commands.append(command)
            misfit.append(np.sqrt(np.mean((fitted - own) ** 2) / np.mean(own**2)))
        materials[name] = commands, np.array(misfit)
    return materials


def _bouc_wen(tag: int, trace: Trace, force: Array, begin: Array) -> tuple[str, Array]:
    """BoucWen: F = α k x + (1 − α) k z, ż = ẋ [A − (γ + β sgn(ẋ z)) |z|ⁿ] with A = 1."""
    model = BoucWen()

    def unpacked(q: Array) -> Array:
        """Stiffness, α, slip force, share of β, exponent."""
        return np.array([np.exp(q[0]), q[3], np.exp(q[1]), 0.5 + 0.5 * q[4], 1.0 + np.exp(q[2])])

    def fitted(q: Array) -> Array:
        k, alpha, slip, beta, power = unpacked(q)
        row = np.array([[k, alpha, slip, slip, beta, power, 0.0]])
        return np.asarray(model.force(row, trace)[0])

    bounds = ([-20, -20, -6, 0.0, 0.0], [20, 20, 2.5, 0.9, 1.0])
    first = np.array([*begin, 0.0, 0.01, 0.2])

    def off(q: Array) -> Array:
        return np.asarray(fitted(q) - force)

    q = least_squares(off, first, bounds=bounds, max_nfev=40).x
    k, alpha, slip, beta, power = unpacked(q)
    scale = (k / slip) ** power  # our z is a force, in slip forces; theirs is a displacement
    line = (
        f"uniaxialMaterial BoucWen {tag} {alpha:.6g} {k:.6g} {power:.6g} "
        f"{(1.0 - beta) * scale:.6g} {beta * scale:.6g} 1.0 0.0 0.0 0.0"
    )
    return line, fitted(q)


def _elastic_plastic(tag: int, trace: Trace, force: Array, begin: Array) -> tuple[str, Array]:
    """ElasticPP: elastic until it slips."""

    def fitted(q: Array) -> Array:
        k, slip = np.exp(q)
        spring, found, before = 0.0, [], 0.0
        for x in trace.displacement.tolist():
            spring = min(max(spring + k * (x - before), -slip), slip)
            before = x
            found.append(spring)
        return np.array(found)

    def off(q: Array) -> Array:
        return np.asarray(fitted(q) - force)

    q = least_squares(off, begin, max_nfev=30).x
    k, slip = np.exp(q)
    return f"uniaxialMaterial ElasticPP {tag} {k:.6g} {slip / k:.6g}", fitted(q)


# --- a model or a run, served to other programs

LOWEST = -1e300
"""Log density outside of all range: JSON has no infinity."""

LONGEST = 2**20  # bytes of a request


@dataclass(frozen=True)
class Served:
    """A function of one vector: its input's and output's names, and itself, (n,) -> (m,)."""

    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    function: Callable[[Array], Array]

    def evaluate(self, content: Any) -> list[list[float]]:
        """Output of the protocol's input, a list of one list; ValueError where there is none."""
        vector = content[0] if isinstance(content, list) and len(content) == 1 else None
        if not (
            isinstance(vector, list)
            and len(vector) == len(self.inputs)
            and all(type(v) in (int, float) and abs(v) <= sys.float_info.max for v in vector)
        ):
            raise ValueError(f"expected [[{', '.join(self.inputs)}]], all finite numbers")
        with np.errstate(all="ignore"):  # what comes of it is no number, which is refused
            output = self.function(np.array(vector, dtype=np.float64))
        if np.any(np.isnan(output) | np.isposinf(output)):
            raise ValueError("the output of this input is no finite number")
        return [np.nan_to_num(output, neginf=LOWEST).tolist()]


def serve(
    source: str,
    port: int,
    motion: Path | None,
    sine: str,
    actuation: str,
    say: Callable[..., Any],
    *,
    trust_model: bool = False,
) -> None:
    """Answer requests on localhost until the process is ended.

    `source` is a run folder, or a model as in a campaign file, whose motion is given as in
    `predict`; `say` takes each sentence on what is served.
    """
    if Path(source).is_dir():
        if motion or sine or actuation:
            raise CampaignError("--motion, --sine and --actuation are for a model, not for a run")
        tests = open_run(Path(source), trust=trust_model).tests
        models = {name: _served(test.posterior) for name, test in tests.items()}
    else:
        models = {"": {"forward": _forward(find_model(source), _trace(motion, sine, actuation))}}
    try:
        server = _Server(("127.0.0.1", port), partial(_Handler, models))
    except OSError as error:
        raise CampaignError(f"--port {port} cannot be used: {error.strerror}") from error
    say(f"serving at http://localhost:{server.server_address[1]} until Ctrl-C")
    if len(models) > 1:
        say(f'config {{"test": ID}} chooses one of {", ".join(models)}; by default the first')
    for name, served in next(iter(models.values())).items():
        shown = [*served.outputs[:20], "..."] if len(served.outputs) > 20 else served.outputs
        say(f"{name}: {', '.join(served.inputs)} -> {', '.join(shown)}")
    with server:
        server.serve_forever()


def _served(posterior: Posterior) -> dict[str, Served]:
    """What is served of one test: log density and values of sampled coordinates; the force."""
    names = posterior.names
    coordinates = tuple(f"q({name})" for name in names)

    def values(q: Array) -> Array:
        every = posterior.values(q[None])
        return np.array([every[name][0] for name in names])

    return {
        "posterior": Served(coordinates, ("log density",), lambda q: posterior.log_prob(q[None])),
        "values": Served(coordinates, _with_units(posterior.model, names), values),
        "forward": _forward(posterior.model, posterior.trace),
    }


def _forward(model: Model, trace: Trace) -> Served:
    """Force of a motion by a model's parameters."""
    inputs = _with_units(model, model.parameters)
    outputs = tuple(f"F({t:g} s)" for t in trace.time.tolist())
    return Served(inputs, outputs, lambda theta: model.force(theta[None], trace)[0])


def _with_units(model: Model, names: Sequence[str]) -> tuple[str, ...]:
    known = units(model)
    return tuple(f"{name} [{known.get(name, '1')}]" for name in names)


def _trace(motion: Path | None, sine: str, actuation: str) -> Trace:
    """Motion of a model."""
    if (motion is None) == (not sine):
        raise CampaignError("give one motion: --motion FILE, or --sine '1 in, 0.5 Hz, 3 cycles'")
    if motion is not None:
        return read_record(motion, actuation=actuation or None).trace()
    level = parse_actuation(actuation, of="--actuation")[0] if actuation else 0.0
    return parse_sine(sine).trace(level)


class _Server(ThreadingHTTPServer):
    """A thread for each connection; many may wait to be accepted."""

    request_queue_size = 128

    def handle_error(self, *connection: Any) -> None:
        """Say nothing of a client that has gone."""
        if not isinstance(sys.exception(), OSError):
            super().handle_error(*connection)


class _Handler(BaseHTTPRequestHandler):
    """Answers to the protocol's requests, in JSON; in one sentence where there is no answer."""

    protocol_version = "HTTP/1.1"
    timeout = 10.0  # s, for the next bytes of a request

    def __init__(self, models: Mapping[str, Mapping[str, Served]], *args: Any) -> None:
        self._models = models
        super().__init__(*args)

    def do_GET(self) -> None:
        """Answer which models there are."""
        if self.path != "/Info":
            self.send_error(404, f"there is no {self.path[:40]}: expected GET /Info")
        elif self._is_local():
            self._answer({"protocolVersion": 1.0, "models": [*next(iter(self._models.values()))]})

    def do_POST(self) -> None:
        """Answer a request on a model, or say what is wrong with it."""
        length = self.headers.get("Content-Length", "")
        if not re.fullmatch(r"[0-9]{1,9}", length) or int(length) > LONGEST:
            sentence = f"expected a Content-Length of at most {LONGEST} bytes, got {length[:20]!r}"
            self.send_error(413, sentence)
            return
        try:
            body = self.rfile.read(int(length))
        except TimeoutError:
            self.send_error(408, f"the {length} bytes of the Content-Length did not come")
            return
        if not self._is_local():
            return
        try:
            content = json.loads(body)
        except (ValueError, RecursionError) as error:
            self.send_error(400, f"the request is no JSON: {why_invalid(error)}")
            return
        try:
            answer = self._result(content)
        except (ValueError, MfdError) as error:
            self.send_error(400, str(error))
        except Exception as error:  # a user's own model may raise anything
            self.send_error(500, f"the model failed: {type(error).__name__}: {error}")
        else:
            self._answer(answer)

    def _is_local(self) -> bool:
        """Whether the request is to this machine by name; a page of another site says its own."""
        host = self.headers.get("Host", "")
        if re.fullmatch(r"(localhost|127\.0\.0\.1|\[::1\])(:\d+)?", host, re.IGNORECASE):
            return True
        self.send_error(403, f"expected the Host localhost, got {host[:80]!r}")
        return False

    def _result(self, content: Any) -> dict[str, Any]:
        """Answer to the content of a request; ValueError where it has none."""
        asked = content if isinstance(content, dict) else {}
        name, config = asked.get("name"), asked.get("config") or {}
        if not isinstance(name, str) or not isinstance(config, dict):
            raise ValueError('expected {"name": NAME, "config": {…}, …}')
        test = config.get("test", next(iter(self._models)))
        models = self._models.get(test, {}) if isinstance(test, str) else {}
        if name not in models:
            raise ValueError(f"there is no test {test!r}, or it has no {name!r}")
        served = models[name]
        if self.path == "/Evaluate":
            return {"output": served.evaluate(content.get("input"))}
        no = dict.fromkeys(("Gradient", "ApplyJacobian", "ApplyHessian"), False)
        answers: dict[str, dict[str, Any]] = {
            "/InputSizes": {"inputSizes": [len(served.inputs)]},
            "/OutputSizes": {"outputSizes": [len(served.outputs)]},
            "/ModelInfo": {"support": {"Evaluate": True} | no},
        }
        if self.path not in answers:
            paths = ", ".join(["/Evaluate", *answers])
            raise ValueError(f"{self.path[:40]} is not supported: expected one of {paths}")
        return answers[self.path]

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:
        """Say in JSON why there is no answer, and close the connection."""
        self.close_connection = True
        sentence = message or explain or HTTPStatus(code).phrase
        self._answer({"error": {"type": "InvalidInput", "message": sentence[:500]}}, code)

    def _answer(self, content: dict[str, Any], status: int = 200) -> None:
        body = json.dumps(content).encode()
        self.send_response(status)
        self.send_header("Content-Type", "application/json")
        self.send_header("Content-Length", str(len(body)))
        if self.close_connection:
            self.send_header("Connection", "close")
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_: Any) -> None:
        """Say nothing of each request."""
