"""A model or a finished run for other programs, by the protocol of UM-Bridge.

Seelinger et al. (2023). The protocol is small, so that the standard library answers it: for this
machine alone, and in valid JSON.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.posterior import Posterior, units
from mfd_bayes.errors import CampaignError, MfdError
from mfd_bayes.friction.model import Model
from mfd_bayes.friction.models import find_model
from mfd_bayes.records.record import read_record
from mfd_bayes.records.trace import Trace, parse_sine
from mfd_bayes.runs.run import open_run
from mfd_bayes.units import parse_actuation

Array = NDArray[np.float64]

LOWEST = -1e300
"""Log density outside of all range: JSON has no infinity."""


@dataclass(frozen=True)
class Served:
    """A function of one vector: its input's and output's names, and itself, (n,) -> (m,)."""

    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    function: Callable[[Array], Array]

    def evaluate(self, content: Any) -> list[list[float]]:
        """Output of the protocol's input, a list of one list; ValueError where it is none."""
        vector = np.array(content, dtype=np.float64)
        if vector.shape != (1, len(self.inputs)) or not np.all(np.isfinite(vector)):
            raise ValueError(f"expected [[{', '.join(self.inputs)}]], all finite")
        return [np.nan_to_num(self.function(vector[0]), neginf=LOWEST).tolist()]


def serve(
    source: str, port: int, motion: Path | None, sine: str, actuation: str, say: Callable[..., Any]
) -> None:
    """Answer requests on localhost until the process is ended.

    `source` is a run folder, or a model as in a campaign file, whose motion is given as in
    `predict`; `say` takes each sentence on what is served.
    """
    if Path(source).is_dir():
        if motion or sine or actuation:
            raise CampaignError("--motion, --sine and --actuation are for a model, not for a run")
        tests = open_run(Path(source)).tests
        models = {name: _served(test.posterior) for name, test in tests.items()}
    else:
        models = {"": {"forward": _forward(find_model(source), _trace(motion, sine, actuation))}}
    try:
        server = ThreadingHTTPServer(("127.0.0.1", port), partial(_Handler, models))
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


class _Handler(BaseHTTPRequestHandler):
    """Answers to the protocol's requests."""

    protocol_version = "HTTP/1.1"

    def __init__(self, models: Mapping[str, Mapping[str, Served]], *args: Any) -> None:
        self._models = models
        super().__init__(*args)

    def do_GET(self) -> None:
        """Answer which models there are."""
        self._answer({"protocolVersion": 1.0, "models": [*next(iter(self._models.values()))]})

    def do_POST(self) -> None:
        """Answer a request on a model, or say what is wrong with it."""
        try:
            content = json.loads(self.rfile.read(int(self.headers.get("Content-Length", 0))))
            test = (content.get("config") or {}).get("test", next(iter(self._models)))
            if test not in self._models or content["name"] not in self._models[test]:
                raise ValueError(f"there is no test {test!r}, or it has no {content['name']!r}")
            self._answer(self._result(self._models[test][content["name"]], content))
        except (KeyError, ValueError, TypeError, AttributeError, MfdError) as error:
            self._answer({"error": {"type": "InvalidInput", "message": str(error)}}, 400)

    def _result(self, served: Served, content: Mapping[str, Any]) -> dict[str, Any]:
        if self.path == "/Evaluate":
            return {"output": served.evaluate(content.get("input"))}
        no = dict.fromkeys(("Gradient", "ApplyJacobian", "ApplyHessian"), False)
        answers: dict[str, dict[str, Any]] = {
            "/InputSizes": {"inputSizes": [len(served.inputs)]},
            "/OutputSizes": {"outputSizes": [len(served.outputs)]},
            "/ModelInfo": {"support": {"Evaluate": True} | no},
        }
        return answers[self.path]

    def _answer(self, content: dict[str, Any], status: int = 200) -> None:
        body = json.dumps(content).encode()
        self.send_response(status)
        self.send_header("Content-Type", "application/json")
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_: Any) -> None:
        """Say nothing of each request."""
