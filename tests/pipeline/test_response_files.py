"""The folder of a response: what an earlier one left in it goes, what is another's stays."""

from types import SimpleNamespace

import numpy as np
import pytest

from mfd_bayes.pipeline import respond
from mfd_bayes.pipeline.respond import Query, view_of, write_response
from mfd_bayes.response.analysis import Analysis
from mfd_bayes.response.building import read_building
from mfd_bayes.response.device_draws import no_dampers
from mfd_bayes.response.ground import Ground
from mfd_bayes.runs.run import open_run
from mfd_bayes.runs.unit_system import US
from tests.run_folders import write_run

EARLIER = ("history_2.png", "loops_2.png", "sweep.png", "sweep.csv")
THEIRS = ("sweep_mine.csv", "notes.txt", "history.png")


def test_what_an_earlier_response_left_goes_and_what_is_anothers_stays(tmp_path, monkeypatch):
    for name in (*EARLIER, *THEIRS):
        (tmp_path / name).write_bytes(b"x")

    def stop(*_):
        raise InterruptedError

    monkeypatch.setattr(respond, "response_json", stop)
    view = SimpleNamespace(title="", verdict=(), remarks=(), rows=(), limits=())
    with pytest.raises(InterruptedError):
        write_response(tmp_path, None, None, view, US)
    assert {path.name for path in tmp_path.iterdir()} == set(THEIRS)


def test_the_page_names_the_run_also_where_it_is_the_current_folder(tmp_path, monkeypatch):
    write_run(tmp_path / "brake 7")
    (tmp_path / "building.toml").write_text(
        '[building]\n[[storey]]\nweight = "20 kip"\nstiffness = "8 kip/in"\n'
    )
    monkeypatch.chdir(tmp_path / "brake 7")
    building = read_building(tmp_path / "building.toml")
    ground = Ground("g", 0.02, 100.0 * np.sin(np.arange(50) / 5.0))
    response = Analysis(building, [ground], no_dampers(10)).respond()
    query = Query(tmp_path / "building.toml", ("g.csv",), tmp_path / "response")
    view = view_of(open_run("."), response, None, query, US)
    assert "of the device in brake 7, 0 dampers" in view.about
