"""A model and a run for other programs, asked by real clients over HTTP."""

import json
import os
import re
import subprocess
import sys
import urllib.error
import urllib.request
from contextlib import contextmanager

import pytest

from tests.command_line import said

THETA = [40.0, 0.02, 0.01, 2.2, 2.0, 2.3, 2.1, 1.0]
"""Of LuGre: sigma0, sigma1, sigma2, Fs_fwd, Fc_fwd, Fs_bwd, Fc_bwd, v_s."""
SINE = ("--sine", "1 in, 0.5 Hz, 2 cycles", "--actuation", "30 lbf")


@contextmanager
def served(*words):
    """Address of a server in a process of its own, and what it says."""
    command = [sys.executable, "-m", "mfd_bayes", "serve", *map(str, words), "--port", "0"]
    env = os.environ | {"PYTHONUNBUFFERED": "1"}
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=env) as process:
        try:
            said = [process.stdout.readline()]
            while "forward: " not in said[-1] and said[-1]:
                said.append(process.stdout.readline())
            yield re.search(r"http://\S+", said[0])[0], "".join(said)
        finally:
            process.terminate()


def ask(address, path, **content):
    request = urllib.request.Request(f"{address}/{path}", json.dumps(content).encode())
    with urllib.request.urlopen(request, timeout=60) as answer:
        return json.load(answer)


def refusal(*arguments, **content):
    with pytest.raises(urllib.error.HTTPError) as error:
        ask(*arguments, **content)
    return error.value.code, json.load(error.value)["error"]["message"]


def test_a_model_gives_the_force_of_a_motion():
    with served("lugre", *SINE) as (address, said):
        with urllib.request.urlopen(f"{address}/Info", timeout=60) as answer:
            assert json.load(answer) == {"protocolVersion": 1.0, "models": ["forward"]}
        assert ask(address, "InputSizes", name="forward") == {"inputSizes": [8]}
        (size,) = ask(address, "OutputSizes", name="forward")["outputSizes"]
        (force,) = ask(address, "Evaluate", name="forward", input=[THETA])["output"]
        assert len(force) == size
        assert max(force) == pytest.approx(2.0, rel=0.1)  # Fc_fwd
        assert ask(address, "ModelInfo", name="forward")["support"]["Evaluate"]
        assert refusal(address, "Evaluate", name="forward", input=[THETA[1:]])[0] == 400
        assert "sigma0 [kip/in]" in refusal(address, "Evaluate", name="forward", input=3)[1]
        assert "sigma0" in refusal(address, "Evaluate", name="forward", input=[[-1, *THETA[1:]]])[1]
        assert refusal(address, "Evaluate", name="backward", input=[THETA])[0] == 400
        assert "sigma0 [kip/in], " in said


def test_what_cannot_be_served_is_one_sentence():
    for words, offender in (
        (("lugre",), "--sine"),
        (("lugrr", *SINE), "lugrr"),
        (("lugre", "--motion", "none.csv"), "none.csv"),
    ):
        assert offender in said("serve", *words, code=2)


def test_a_run_gives_its_log_posterior_and_its_force(out, run):
    test = list(run.tests.values())[1]
    posterior = test.posterior
    q = posterior.coordinates(test.stored.values())[:1]
    drawn = posterior.values(q)
    theta = posterior.theta(drawn)
    expected = {
        "posterior": (q, posterior.log_prob(q)),
        "values": (q, [drawn[name][0] for name in posterior.names]),
        "forward": (theta, posterior.model.force(theta, test.trace)[0]),
    }
    with served(out) as (address, said):
        with urllib.request.urlopen(f"{address}/Info", timeout=60) as answer:
            assert json.load(answer)["models"] == [*expected]
        for name, (point, values) in expected.items():
            words = {"name": name, "config": {"test": test.id}}
            assert ask(address, "InputSizes", **words) == {"inputSizes": [point.size]}
            (answer,) = ask(address, "Evaluate", input=point.tolist(), **words)["output"]
            assert answer == pytest.approx(values)
        far = {"name": "posterior", "input": [[1e9] * posterior.dim]}
        assert ask(address, "Evaluate", **far)["output"] == [[-1e300]]  # of the first test
        assert f"q({posterior.names[0]})" in said
        assert "no test" in refusal(address, "Evaluate", config={"test": "no"}, **far)[1]


def test_a_client_of_the_protocol_is_answered():
    umbridge = pytest.importorskip("umbridge", reason="needs the extra umbridge")
    with served("lugre", *SINE) as (address, _):
        assert umbridge.supported_models(address) == ["forward"]
        (force,) = umbridge.HTTPModel(address, "forward")([THETA])
        assert max(force) == pytest.approx(2.0, rel=0.1)
