import struct
import tracemalloc

import numpy as np
import pytest
from nptdms import ChannelObject, RootObject, TdmsWriter

from mfd_bayes.errors import RecordError
from mfd_bayes.records.readers import read_table

TIME = np.arange(30) / 10
FORCE = np.sin(TIME) / 3


def write(folder, *channels, parts=1, name="a.tdms"):
    """File of (group, channel, values, properties), written so many times."""
    with TdmsWriter(folder / name) as writer:
        for _ in range(parts):
            writer.write_segment([ChannelObject(*channel) for channel in channels])
    return folder / name


def wave(increment=0.01, **properties):
    return {"wf_increment": increment, "wf_start_offset": 0.5, **properties}


# --- files as their format says, for what no writer writes


def text(word):
    return struct.pack("<L", len(word)) + word


def part(samples, data=b"", *, follows=None, kind=10):
    """Part of a file with channel x of so many doubles, and other data than these."""
    listed = struct.pack("<L", 1) + text(b"/'G'/'x'")
    listed += struct.pack("<LLLQL", 20, kind, 1, samples, 0)
    after = len(listed) + len(data) if follows is None else follows
    return struct.pack("<4sLLQQ", b"TDSm", 14, 4713, after, len(listed)) + listed + data


TEN = np.arange(10.0).tobytes()


def test_channels_are_columns_with_their_units(tmp_path):
    path = write(
        tmp_path,
        ("Test 1", "Time", TIME, {"unit_string": "s"}),
        ("Test 1", "Disp", np.arange(30, dtype=np.int16), {"unit_string": "mm"}),
        ("Test 1", "Force", FORCE, {"NI_UnitDescription": "[kN]"}),
        ("Test 1", "Other", FORCE, {}),
    )
    table = read_table(path)
    assert table.names == ("Time", "Disp", "Force", "Other")
    assert dict(table.units) == {"Time": "s", "Disp": "mm", "Force": "kN"}
    columns = table.columns(["Force", "Disp"])
    np.testing.assert_array_equal(columns["Force"], FORCE)
    np.testing.assert_array_equal(columns["Disp"], np.arange(30.0))
    assert columns["Disp"].dtype == np.float64


def test_channels_that_share_a_name_are_told_apart_by_their_groups(tmp_path):
    path = write(tmp_path, ("A", "x", TIME), ("B", "x", FORCE), ("B", "y", FORCE))
    assert read_table(path).names == ("A/x", "B/x", "y")
    np.testing.assert_array_equal(read_table(path).columns(["B/x"])["B/x"], FORCE)


def test_the_increments_of_waveforms_make_a_time(tmp_path):
    path = write(tmp_path, ("G", "x", FORCE, wave()), ("G", "F", FORCE, wave()), parts=2)
    table = read_table(path)
    assert table.names == ("time", "x", "F")
    assert table.units["time"] == "s"
    np.testing.assert_allclose(table.columns(["time", "x"])["time"], 0.5 + np.arange(60) / 100)


def test_groups_of_different_increments_have_a_time_each(tmp_path):
    path = write(tmp_path, ("A", "x", FORCE, wave()), ("B", "F", FORCE, wave(0.1)))
    assert read_table(path).names == ("A/time", "B/time", "x", "F")
    times = read_table(path).columns(["B/time"])["B/time"]
    np.testing.assert_allclose(times, 0.5 + np.arange(30) / 10)


@pytest.mark.parametrize(
    "channels",
    [
        [("G", "Elapsed Time", TIME, {}), ("G", "x", FORCE, wave())],
        [("G", "t", TIME, {"unit_string": "ms"}), ("G", "x", FORCE, wave())],
        [("G", "x", FORCE, {}), ("G", "F", FORCE, {})],
        [("G", "x", FORCE, wave(0.0)), ("G", "F", FORCE, wave(np.nan))],
        [("G", "x", FORCE, wave(wf_xunit_string="Hz")), ("G", "F", FORCE, {})],
        [("G", "x", FORCE, wave()), ("G", "F", FORCE, wave(0.1))],
    ],
    ids=["a time", "in ms", "no waveform", "no increment", "a spectrum", "two clocks in a group"],
)
def test_no_time_is_offered_where_there_is_one_or_none_can_be_made(tmp_path, channels):
    assert read_table(write(tmp_path, *channels)).names == (channels[0][1], channels[1][1])


@pytest.mark.parametrize(
    ("values", "held"),
    [(["a", "b"], "text"), (1j * TIME, "complex numbers")],
)
def test_channels_without_numbers_are_refused_when_used(tmp_path, refused, values, held):
    path = write(tmp_path, ("G", "x", TIME), ("G", "note", values))
    np.testing.assert_array_equal(read_table(path).columns(["x"])["x"], TIME)
    assert refused(path, ["note"]) == (
        f"sample 1 of {path}, column 'note': expected a finite number, found {held!r}"
    )


def test_a_value_that_is_not_finite_is_named_by_its_sample(tmp_path, refused):
    path = write(tmp_path, ("G", "x", np.array([1.0, np.inf])))
    assert refused(path, ["x"]) == (
        f"sample 2 of {path}, column 'x': expected a finite number, found 'inf'"
    )


def test_channels_of_different_lengths_are_refused_together(tmp_path, refused):
    path = write(tmp_path, ("G", "a", TIME), ("G", "b", TIME[:9]))
    assert refused(path, ["a", "b"]) == f"columns of {path} have different lengths: a 30, b 9"


def test_a_file_without_channels_is_refused(tmp_path, refused):
    path = tmp_path / "a.tdms"
    with TdmsWriter(path) as writer:
        writer.write_segment([RootObject({"operator": "x"})])
    assert refused(path) == f"{path} holds no channel with data"


def test_what_is_no_tdms_file_is_refused(tmp_path, refused):
    path = tmp_path / "a.tdms"
    for content in (b"hello world" * 9, b"TDSm" + bytes(90), b"TDSh" + bytes(90)):
        path.write_bytes(content)
        assert refused(path) == f"{path} is not a TDMS file that can be read"


def test_the_file_itself_is_read_and_not_an_index_beside_it(tmp_path):
    path = write(tmp_path, ("G", "x", TIME))
    other = write(tmp_path, ("G", "y", FORCE), name="b.tdms")
    path.with_name("a.tdms_index").write_bytes(b"TDSh" + other.read_bytes()[4:])
    assert read_table(path).names == ("x",)


def test_a_file_that_is_cut_off_is_refused(tmp_path, refused, capfd):
    path = write(tmp_path, ("G", "x", TIME))
    path.write_bytes(path.read_bytes()[:-80])
    assert refused(path, ["x"]) == (
        f"{path} is cut off: its last part declares 30 samples of channel /'G'/'x' and holds 20"
    )
    assert capfd.readouterr().err == ""


def test_a_part_that_was_never_closed_is_read_where_it_is_whole(tmp_path):
    path = tmp_path / "a.tdms"
    path.write_bytes(part(5, TEN, follows=2**64 - 1))
    np.testing.assert_array_equal(read_table(path).columns(["x"])["x"], np.arange(10))


@pytest.mark.parametrize("samples", [11, 10**12, 2**63])
@pytest.mark.parametrize("follows", [None, 10**15, 2**64 - 1])
def test_declared_samples_that_are_not_there_are_refused(tmp_path, refused, samples, follows):
    path = tmp_path / "a.tdms"
    path.write_bytes(part(samples, TEN, follows=follows))
    assert refused(path, ["x"]) == (
        f"{path} is cut off: its last part declares {samples:,} samples of channel /'G'/'x' and "
        "holds 10"
    )


def test_more_samples_than_are_read_are_refused(tmp_path, refused):
    path = tmp_path / "a.tdms"
    path.write_bytes(part(10**8, follows=len(part(1)) - 28 + 8 * 10**8))
    with path.open("ab") as file:
        file.truncate(path.stat().st_size + 8 * 10**8)  # without taking room on the disk
    assert refused(path, ["x"]) == (
        f"{path} holds more than 50,000,000 samples, the most that are read"
    )


def test_texts_that_take_no_room_cannot_be_counted_up(tmp_path, refused):
    path = tmp_path / "a.tdms"
    listed = struct.pack("<L", 1) + text(b"/'G'/'x'")
    listed += struct.pack("<LLLQQL", 28, 0x20, 1, 10**9, 80, 0)
    head = struct.pack("<4sLLQQ", b"TDSm", 14, 4713, len(listed) + 80, len(listed))
    path.write_bytes(head + listed + TEN)
    assert "holds more than 50,000,000 samples" in refused(path, ["x"])


def test_a_text_of_gigabytes_is_not_asked_for(tmp_path):
    """A property's name that says it is 4 GB long: no more is read than the file has."""
    path = tmp_path / "a.tdms"
    listed = struct.pack("<L", 1) + text(b"/'G'/'x'") + struct.pack("<L", 0xFFFFFFFF)
    listed += struct.pack("<LL", 1, 0xFFFFFFF0) + b"unit"
    path.write_bytes(struct.pack("<4sLLQQ", b"TDSm", 14, 4713, len(listed), len(listed)) + listed)
    tracemalloc.start()
    with pytest.raises(RecordError, match=r"a\.tdms"):
        read_table(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 50e6
