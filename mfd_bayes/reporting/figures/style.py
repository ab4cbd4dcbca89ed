"""The look of every figure, and how one becomes a PNG."""

from __future__ import annotations

import io
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

from mfd_bayes.evaluation.views import Fan, Interval
from mfd_bayes.reporting.colours import BANDS
from mfd_bayes.units import percent

DPI = 105
LOOKED_AT = 11
"""One of so many pixels is counted to find the colours of surfaces. It is a prime, because hardly
any width of a picture is a multiple of it; then only some columns would be counted."""

_STYLE: dict[str, object] = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 9,
    "axes.titlesize": 10,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.titley": 1.0,  # where Matplotlib puts it too, after it has measured all labels
    "figure.titlesize": 11,
    "figure.titleweight": "bold",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#666666",
    "axes.linewidth": 0.7,
    "axes.grid": True,
    "grid.color": "#e6e6e6",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "xtick.color": "#444444",
    "ytick.color": "#444444",
    "legend.frameon": False,
    "legend.fontsize": 8,
    "lines.linewidth": 1.1,
    "agg.path.chunksize": 0,
}


@contextmanager
def style() -> Iterator[None]:
    """Draw with the report's settings of matplotlib, not with the user's."""
    with matplotlib.rc_context(), warnings.catch_warnings():
        # a name from a file may have letters that DejaVu does not have
        warnings.filterwarnings("ignore", message="Glyph .* missing from font")
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(_STYLE)  # type: ignore[arg-type]
        yield


def new_figure(width: float, height: float) -> Figure:
    """Empty figure of a size in inches, with a layout that cuts nothing off."""
    return Figure(figsize=(width, height), dpi=DPI, layout="constrained")


@style()
def to_png(figure: Figure) -> bytes:
    """PNG of a figure, the same bytes each time; with few colours it has a third of the size."""
    canvas: Any = FigureCanvasAgg(figure)
    canvas.draw()  # once: savefig would draw twice where there is a layout
    size = canvas.get_width_height()
    drawn = Image.frombuffer("RGBA", size, canvas.buffer_rgba()).convert("RGB")
    few = drawn.quantize(256, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    few.putpalette(_most_frequent(few, drawn).ravel().tolist())
    packed = io.BytesIO()
    few.save(packed, "png", compress_level=6)
    return packed.getvalue()


def _most_frequent(few: Image.Image, drawn: Image.Image) -> NDArray[np.int64]:
    """Palette of a picture, (colours, 3), with the colour that pixels of each most often have.

    An octree takes their mean: white paper and a band would be a little off.
    """
    palette: NDArray[np.int64] = np.reshape(few.getpalette() or [], (-1, 3))
    chosen = np.asarray(few).ravel()[::LOOKED_AT].astype(np.int64)
    colours = np.asarray(drawn).reshape(-1, 3)[::LOOKED_AT] @ np.array([1 << 16, 1 << 8, 1])
    found, times = np.unique(chosen << 24 | colours, return_counts=True)
    by_times = found[np.argsort(times, kind="stable")]  # the most frequent one is set last
    palette[by_times >> 24] = by_times[:, None] >> np.array([16, 8, 0]) & 255
    return palette


def shades(fan: Fan) -> Iterator[tuple[Interval, str]]:
    """Intervals of a fan, widest first, each with its colour."""
    wide, narrow, _ = BANDS[fan.kind]
    ordered = sorted(fan.intervals, key=lambda i: (not i.whole, -i.probability))
    for index, interval in enumerate(ordered):
        yield interval, wide if index == 0 else narrow


def percents(fan: Fan) -> str:
    """Probabilities of a fan's intervals: "50 and 95 %"."""
    chances = sorted(i.probability for i in fan.intervals if not i.whole)
    pale = "; pale: of the whole history" if any(i.whole for i in fan.intervals) else ""
    return " and ".join(percent(chance) for chance in chances) + f" %{pale}"


def no_ticks(axes: Axes) -> None:
    """Hide the vertical axis, where only relative heights matter."""
    axes.set_yticks([])
    axes.spines["left"].set_visible(False)
    axes.grid(visible=False, axis="y")
