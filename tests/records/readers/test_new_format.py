"""A file format is added by one function and one line: see docs/pages/architecture.md."""

from types import MappingProxyType

import numpy as np

import mfd_bayes as mb
from mfd_bayes.records import readers
from mfd_bayes.records.readers.table import Table


def read_spaced(path):
    """Toy: a line of names, then numbers, with blanks between them."""
    names, *lines = path.read_text().splitlines()
    columns = dict(
        zip(names.split(), np.array([line.split() for line in lines], float).T, strict=True)
    )
    places = [f"line {row + 2}" for row in range(len(lines))]
    return Table(path, columns, places)


def test_a_format_that_is_registered_is_read(tmp_path, monkeypatch):
    formats = MappingProxyType(dict(readers.FORMATS) | {".toy": read_spaced})
    monkeypatch.setattr(readers, "FORMATS", formats)
    time = np.arange(100) * 0.05
    rows = np.column_stack([time, np.sin(2 * time), np.cos(2 * time)])
    path = tmp_path / "a.toy"
    np.savetxt(path, rows, "%.6f", header="time_s displacement_in force_kip", comments="")
    record = mb.read_record(path)
    np.testing.assert_allclose(record.force, rows[:, 2], atol=1e-6)
