"""The folder of a response: what an earlier one left in it goes, what is another's stays."""

import numpy as np
from typer.testing import CliRunner

from mfd_bayes.cli.commands import app
from tests.run_folders import write_run

EARLIER = ("history_2.png", "loops_2.png", "sweep.png", "sweep.csv")
THEIRS = ("sweep_mine.csv", "notes.txt", "history.png")


def test_an_earlier_response_goes_and_what_is_anothers_stays(tmp_path, monkeypatch):
    out, folder = tmp_path / "brake 7", tmp_path / "response"
    write_run(out)
    folder.mkdir()
    for name in (*EARLIER, *THEIRS):
        (folder / name).write_bytes(b"x")
    (tmp_path / "building.toml").write_text(
        '[building]\n[[storey]]\nweight = "20 kip"\nstiffness = "8 kip/in"\n'
    )
    rows = "".join(f"{0.02 * k:.2f},{100.0 * np.sin(k / 5.0):.4f}\n" for k in range(50))
    (tmp_path / "g.csv").write_text("time_s,acceleration_in/s^2\n" + rows)
    monkeypatch.chdir(out)  # whose name the page says all the same
    words = ("respond", ".", "--building", "../building.toml", "--ground", "../g.csv", "--force")
    ended = CliRunner().invoke(app, [*words, "-o", str(folder), "--draws", "10", "--jobs", "1"])
    assert ended.exit_code == 0, ended.output
    names = {path.name for path in folder.iterdir()}
    assert names >= {"report.html", "peaks.csv", "response.json", *THEIRS}
    assert not names & set(EARLIER)
    assert "of the device in brake 7, 0 dampers" in (folder / "report.html").read_text()
