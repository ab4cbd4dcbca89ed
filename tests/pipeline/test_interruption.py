"""Real processes, killed while they work: what they leave, and what a resumed run makes of it."""

import os
import shutil
import signal
import subprocess
import time
from pathlib import Path

import pytest

from mfd_bayes.campaign.synthetic import Matrix, write_campaign
from tests.run_folders import differing, files

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        not Path("/proc/self/stat").is_file(), reason="looks for processes in Linux's /proc"
    ),
]
TIMED = ("manifest.json", "report.html")  # they say when, and how long
EXITS = {"SIGINT": 130, "SIGTERM": 143, "SIGKILL": -9}
LIMIT = 600.0  # s, far more than any command here takes


def processes_of(session):
    processes = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, parent, _, leader = stat.read_text().rpartition(")")[2].split()[:4]
            line = stat.with_name("cmdline").read_text()
        except OSError:  # it has ended
            continue
        if int(leader) == session and state != "Z":
            processes[int(stat.parent.name)] = int(parent), line
    return processes


class Process:
    """A command as a process in a session of its own; at the end nothing of it is alive."""

    def __init__(self, path, *words):
        self.words = [*map(str, words)]
        self.printed, self.complaint = (path.parents[1] / name for name in ("printed", "complaint"))

    def __enter__(self):
        environment = os.environ | {"PYTHONUNBUFFERED": "1", "OPENBLAS_NUM_THREADS": "1"}
        with self.printed.open("w") as stdout, self.complaint.open("w") as stderr:
            self.process = subprocess.Popen(
                self.words, stdout=stdout, stderr=stderr, env=environment, start_new_session=True
            )
        return self

    def __exit__(self, *_):
        for pid in processes_of(self.process.pid):
            os.kill(pid, signal.SIGKILL)
        self.process.wait()

    def until(self, condition):
        """Wait until a condition holds, or the command has ended; whether it still runs."""
        while self.process.poll() is None and not condition():
            time.sleep(0.002)
        return self.process.poll() is None

    def says(self, words):
        return words in self.printed.read_text()

    def workers(self):
        """Processes that do its jobs: forked from a server of processes, or started anew."""
        tree = processes_of(self.process.pid)
        servers = {pid for pid, (_, line) in tree.items() if "multiprocessing.forkserver" in line}
        return [p for p, (parent, line) in tree.items() if parent in servers or "_main(" in line]

    def end(self):
        """Exit code and messages, once the command and all that it has started have ended."""
        code = self.process.wait(timeout=LIMIT)
        deadline = time.monotonic() + 15
        while processes_of(self.process.pid) and time.monotonic() < deadline:
            time.sleep(0.05)
        assert not processes_of(self.process.pid)
        complaint = self.complaint.read_text()
        assert len(complaint.splitlines()) <= 1, complaint
        return code, complaint


@pytest.fixture(scope="module")
def campaign(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("campaign")
    matrix = Matrix((500.0, 1000.0), frequencies=(0.5,), cycles=(1,), held_out=(800.0, 0.5))
    write_campaign(folder, 1, matrix)
    path = folder / "campaign.toml"
    text = path.read_text().replace('"ou"', '"iid"\nrate = "25 Hz"')
    path.write_text(text.replace('"three_stage"', '"lugre"'))
    return path


@pytest.fixture(scope="module")
def start(campaign, without_figures):
    words = (*without_figures, "calibrate", campaign, "--effort", "quick", "-o")
    return lambda folder, *options: Process(folder, *words, folder, *options)


@pytest.fixture(scope="module")
def whole(start, tmp_path_factory) -> Path:
    """Folder of the run that nothing disturbs."""
    folder = tmp_path_factory.mktemp("whole") / "disk" / "out"
    folder.parent.mkdir()
    with start(folder, "--jobs", 2) as run:
        assert run.end() == (0, "")
    return folder


@pytest.fixture
def out(tmp_path):
    (tmp_path / "disk").mkdir()
    return tmp_path / "disk" / "out"


def assert_finished(start, folder, reference, *options):
    """Assert that a resumed run ends well, with the same files, to the bit."""
    with start(folder, "--resume", *options) as run:
        assert run.end() == (0, "")
    assert files(folder) == files(reference)
    assert differing(folder, reference) == []


# --- killed


def test_a_run_ended_again_and_again_is_finished_to_the_same_bits(start, whole, out):
    jobs, came = 2, 0
    out.mkdir()  # an earlier run was killed before it had a manifest
    (out / ".manifest.json.ab12cd34.part").write_text("{")
    for kind, words in (("SIGINT", ": sampling"), ("SIGTERM", "population: "), ("SIGKILL", "rep")):
        with start(out, "--resume", "--jobs", jobs) as run:
            if run.until(lambda run=run, words=words: run.says(words)):
                run.process.send_signal(getattr(signal, kind))
            code, complaint = run.end()
        assert code in (0, EXITS[kind])
        came += code != 0
        if code in (130, 143):
            assert complaint.startswith("mfd-bayes: interrupted")
            assert "--resume" in complaint
        assert [name for name in differing(out, whole) if name not in TIMED] == []
        jobs = 3 - jobs
    assert came
    assert_finished(start, out, whole)


def test_a_test_whose_process_is_killed_begins_again(start, whole, out):
    with start(out, "--jobs", 2) as run:
        # not sooner: while the server of processes imports, it may start others, such as fc-list
        assert run.until(lambda: run.says("finding modes"))
        os.kill(run.workers()[0], signal.SIGKILL)  # at once: no test is done so soon
        assert run.end() == (0, "")
    (line,) = [line for line in run.printed.read_text().splitlines() if "killed" in line]
    assert line.startswith("processes: note: one was killed; begins again: ")
    assert files(out) == files(whole)
    assert differing(out, whole) == []


def test_an_interrupted_demo_has_its_campaign_and_can_be_resumed(without_figures, out):
    with Process(out, *without_figures, "demo", out, "--quick", "--jobs", 1) as run:
        assert run.until(lambda: run.says("p500_f0.05: sampling"))
        run.process.send_signal(signal.SIGINT)
        code, complaint = run.end()
    assert code == 130
    assert f"calibrate {out / 'campaign/campaign.toml'} -o {out}" in complaint
    assert "--resume" in complaint
    assert len(list((out / "campaign").glob("*.csv"))) == 11  # of --quick
    assert (out / "campaign.toml").read_bytes() == (out / "campaign/campaign.toml").read_bytes()


# --- a disk that takes nothing


@pytest.fixture
def disk(out):
    """Put a small disk under the run folder; a call mounts it again with other options."""
    if os.geteuid() != 0 or shutil.which("mount") is None:
        pytest.skip("only root can mount a small tmpfs")

    def mount(*words):
        subprocess.run(["mount", *words, str(out.parent)], check=True, capture_output=True)

    try:
        mount("-t", "tmpfs", "-o", "size=16k", "tmpfs")
    except subprocess.CalledProcessError:
        pytest.skip("this system does not let root mount a tmpfs")
    yield mount
    while out.parent.is_mount():
        subprocess.run(["umount", "-l", str(out.parent)], check=True)


def test_a_full_disk_is_said_in_a_sentence_and_resumed_when_there_is_room(start, whole, out, disk):
    posterior = next(whole.rglob("posterior.nc")).stat().st_size
    for size, jobs in ((16, 1), (int(1.5 * posterior) // 1024, 2)):
        disk("-o", f"remount,size={size}k")
        with start(out, "--resume", "--jobs", jobs) as run:
            code, complaint = run.end()
        assert code == 2
        assert complaint.startswith(f"mfd-bayes: cannot write {out}")
        assert complaint.endswith("No space left on device\n")
        assert not list(out.rglob(".*"))
        assert [name for name in differing(out, whole) if name not in TIMED] == []
    disk("-o", "remount,size=64m")
    assert_finished(start, out, whole)
