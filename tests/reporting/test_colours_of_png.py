"""Colours of a PNG, of which there are few."""

import io

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from mfd_bayes.reporting.figures import style
from mfd_bayes.reporting.figures.style import to_png

PALE, GREY, RED = (255, 243, 214), (230, 230, 230), (213, 94, 0)


@pytest.fixture
def png():
    """A pale surface, grey lines on white, and one small red dot, with soft edges."""

    def draw():
        figure = Figure(figsize=(4, 3), dpi=100)
        axes = figure.add_axes((0, 0, 1, 1))
        axes.set_axis_off()
        axes.axvspan(0.0, 0.3, color=np.divide(PALE, 255))
        for height in np.linspace(0.0, 1.0, 23):
            axes.plot([0.0, 1.0], [height, 1.0 - 0.7 * height], color=np.divide(GREY, 255))
        axes.plot([0.8], [0.05], "o", color=np.divide(RED, 255), markersize=4)
        return np.asarray(Image.open(io.BytesIO(to_png(figure))).convert("RGB"))

    return draw


def number(picture, colour):
    """Pixels of exactly this colour."""
    return int(np.count_nonzero(np.all(picture == colour, axis=2)))


def test_paper_surfaces_and_dots_keep_their_colours(png, monkeypatch):
    picture = png()
    assert number(picture, (255, 255, 255)) > 10_000
    assert number(picture, PALE) > 5_000
    red = np.abs(picture.astype(int) - RED).max(axis=2)
    assert np.count_nonzero(red < 20) > 4
    monkeypatch.setattr(
        style, "_most_frequent", lambda few, _: np.reshape(few.getpalette(), (-1, 3))
    )
    assert number(png(), (255, 255, 255)) == 0  # the control: an octree's means
