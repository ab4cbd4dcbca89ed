"""A model, or a run's log posterior, served by UM-Bridge (Seelinger et al., 2023)."""

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

from mfd_bayes.applications.export.options import ServeOptions
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.priors import units
from mfd_bayes.console import say
from mfd_bayes.errors import CampaignError, MfdError, why_invalid
from mfd_bayes.friction.model import Model
from mfd_bayes.friction.models import find_model
from mfd_bayes.records.record import read_record
from mfd_bayes.records.trace import Trace, parse_sine
from mfd_bayes.runs.run import open_run
from mfd_bayes.units import parse_actuation

Array = NDArray[np.float64]

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


def serve(options: ServeOptions) -> None:
    """Answer requests on localhost until the process is ended; what is served is printed."""
    source, motion = options.source, (options.motion, options.sine, options.actuation)
    if Path(source).is_dir():
        if any(motion):
            raise CampaignError("--motion, --sine and --actuation are for a model, not for a run")
        tests = open_run(Path(source), trust=options.trust_model).tests
        models = {name: _served(test.posterior) for name, test in tests.items()}
    else:
        models = {"": {"forward": _forward(find_model(source), _trace(*motion))}}
    try:
        server = _Server(("127.0.0.1", options.port), partial(_Handler, models))
    except OSError as error:
        raise CampaignError(f"--port {options.port} cannot be used: {error.strerror}") from error
    say(f"serving at http://localhost:{server.server_address[1]} until Ctrl-C")
    if len(models) > 1:
        say(f'config {{"test": ID}} chooses one of {", ".join(models)}; by default the first')
    for name, served in next(iter(models.values())).items():
        names = [*served.outputs[:20], "..."] if len(served.outputs) > 20 else served.outputs
        say(f"{name}: {', '.join(served.inputs)} -> {', '.join(names)}")
    with server:
        server.serve_forever()


def _served(posterior: Posterior) -> dict[str, Served]:
    """What is served of one test: log density and values of sampled coordinates; the force."""
    names = posterior.names
    coordinates = tuple(f"q({name})" for name in names)

    def values(q: Array) -> Array:
        all_values = posterior.values(q[None])
        return np.array([all_values[name][0] for name in names])

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
    unit_of = units(model)
    return tuple(f"{name} [{unit_of.get(name, '1')}]" for name in names)


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
        request = content if isinstance(content, dict) else {}
        name, config = request.get("name"), request.get("config") or {}
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
