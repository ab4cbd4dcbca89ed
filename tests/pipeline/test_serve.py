"""A model and a run for other programs, asked by real clients over HTTP."""

import json
import os
import re
import socket
import struct
import subprocess
import sys
import urllib.error
import urllib.request
from concurrent.futures import ThreadPoolExecutor
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
            lines = [process.stdout.readline()]
            while "forward: " not in lines[-1] and lines[-1]:
                lines.append(process.stdout.readline())
            yield re.search(r"http://\S+", lines[0])[0], "".join(lines)
        finally:
            process.terminate()


@pytest.fixture(scope="module")
def model_server():
    with served("lugre", *SINE) as (address, _):
        yield address


def ask(address, path, **content):
    request = urllib.request.Request(f"{address}/{path}", json.dumps(content).encode())
    with urllib.request.urlopen(request, timeout=60) as answer:
        return json.load(answer)


def refusal(*arguments, **content):
    with pytest.raises(urllib.error.HTTPError) as error:
        ask(*arguments, **content)
    return error.value.code, json.load(error.value)["error"]["message"]


def test_a_model_gives_the_force_of_a_motion():
    with served("lugre", *SINE) as (address, output):
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
        assert "sigma0 [kip/in], " in output


def sent(address, text):
    """Status and content that a server sends to the bytes of a client, which then says no more."""
    host, port = address.removeprefix("http://").split(":")
    with socket.create_connection((host, int(port)), timeout=60) as client:
        client.sendall(text.encode())
        client.shutdown(socket.SHUT_WR)
        answer = b"".join(iter(lambda: client.recv(2**16), b"")).decode()
    head, _, body = answer.partition("\r\n\r\n")
    return head.split()[1], json.loads(body)


@pytest.mark.parametrize(
    ("request_line", "host", "length", "body", "status", "words"),
    [
        ("POST /Evaluate", "evil.example", None, "{}", "403", "expected the Host localhost"),
        ("GET /Info", "evil.example:80", 0, "", "403", "expected the Host localhost"),
        ("GET /etc/passwd", "localhost", 0, "", "404", "there is no /etc/passwd"),
        ("PUT /Evaluate", "localhost", 0, "", "501", "Unsupported method"),
        ("GET /" + "a" * 70_000, "localhost", 0, "", "414", "Too Long"),
        ("POST /Evaluate", "localhost", "-1", "{}", "413", "expected a Content-Length"),
        ("POST /Evaluate", "localhost", "9" * 14, "{}", "413", "expected a Content-Length"),
        ("POST /Evaluate", "localhost", "9", '{"name"', "400", "no JSON"),
        ("POST /Evaluate", "localhost", None, "[" * 100_000, "400", "no JSON"),
        ("POST /Evaluate", "localhost", None, "[1]", "400", 'expected {"name": NAME'),
        ("POST /Evaluate", "localhost", None, '{"name": ["x"]}', "400", 'expected {"name": NAME'),
        ("POST /Nope", "localhost", None, '{"name": "forward"}', "400", "/Nope is not supported"),
        *(
            ("POST /Evaluate", "localhost", None, json.dumps({"name": "forward", "input": v}), *end)
            for v in ([[10**400] * 8], [[float("nan")] * 8], [[True] * 8], [["1"] * 8], [[1], [2]])
            for end in [("400", "all finite numbers")]
        ),
    ],
)
def test_a_malformed_request_is_answered_in_one_sentence(
    model_server, request_line, host, length, body, status, words
):
    length = len(body) if length is None else length
    head = f"{request_line} HTTP/1.1\r\nHost: {host}\r\nContent-Length: {length}\r\n\r\n"
    code, answer = sent(model_server, head + body)
    assert (code, words in answer["error"]["message"]) == (status, True)


def test_thirty_clients_are_answered_and_nothing_is_printed(capfd):
    with served("lugre", *SINE) as (address, _):

        def client(_):
            return ask(address, "Evaluate", name="forward", input=[THETA])["output"][0][1]

        with ThreadPoolExecutor(30) as clients:
            assert len(set(clients.map(client, range(60)))) == 1
        host, port = address.removeprefix("http://").split(":")
        for _ in range(5):  # clients that do not wait for an answer
            with socket.create_connection((host, int(port))) as connection:
                connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
                connection.sendall(b"GET /Info HTTP/1.1\r\nHost: localhost\r\n\r\n" * 50)
        ask(address, "ModelInfo", name="forward")
        assert capfd.readouterr().err == ""


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
    draws = posterior.values(q)
    theta = posterior.theta(draws)
    expected = {
        "posterior": (q, posterior.log_prob(q)),
        "values": (q, [draws[name][0] for name in posterior.names]),
        "forward": (theta, posterior.model.force(theta, test.trace)[0]),
    }
    with served(out) as (address, output):
        with urllib.request.urlopen(f"{address}/Info", timeout=60) as answer:
            assert json.load(answer)["models"] == [*expected]
        for name, (point, values) in expected.items():
            words = {"name": name, "config": {"test": test.id}}
            assert ask(address, "InputSizes", **words) == {"inputSizes": [point.size]}
            (answer,) = ask(address, "Evaluate", input=point.tolist(), **words)["output"]
            assert answer == pytest.approx(values)
        far = {"name": "posterior", "input": [[1e9] * posterior.dim]}
        assert ask(address, "Evaluate", **far)["output"] == [[-1e300]]  # of the first test
        assert f"q({posterior.names[0]})" in output
        assert "no test" in refusal(address, "Evaluate", config={"test": "no"}, **far)[1]


def test_a_client_of_the_protocol_is_answered():
    umbridge = pytest.importorskip("umbridge", reason="needs the extra umbridge")
    with served("lugre", *SINE) as (address, _):
        assert umbridge.supported_models(address) == ["forward"]
        (force,) = umbridge.HTTPModel(address, "forward")([THETA])
        assert max(force) == pytest.approx(2.0, rel=0.1)
