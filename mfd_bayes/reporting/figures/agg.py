"""Matplotlib with its backend Agg, the look of every figure, and how one becomes a PNG.

A notebook gives its programs a backend that other environments do not have, and Matplotlib writes
to stderr where it cannot write to its home. Figures here are drawn by Agg and need neither.
"""

from __future__ import annotations

import io
import logging
import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from PIL import Image

from mfd_bayes.evaluation.views import Fan, Interval
from mfd_bayes.reporting.symbols import BANDS, plain
from mfd_bayes.units import percent


@contextmanager
def _quiet_agg() -> Iterator[None]:
    """Import with the backend Agg and without log lines; both are put back."""
    log, backend = logging.getLogger("matplotlib"), os.environ.get("MPLBACKEND")
    level = log.level
    log.setLevel(logging.ERROR)
    os.environ["MPLBACKEND"] = "agg"
    try:
        yield
    finally:
        log.setLevel(level)
        del os.environ["MPLBACKEND"]
        if backend is not None:
            os.environ["MPLBACKEND"] = backend


with _quiet_agg():
    import matplotlib
    import matplotlib.font_manager  # which may have to be made first
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

DPI = 105

_STYLE: dict[Any, Any] = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 9,
    "axes.titlesize": 9,
    "axes.titleweight": "normal",
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
}


@contextmanager
def style() -> Iterator[None]:
    """Draw with the report's settings of Matplotlib, not with the user's."""
    with matplotlib.rc_context(), warnings.catch_warnings():
        # a name from a file may have letters that DejaVu does not have
        warnings.filterwarnings("ignore", message="Glyph .* missing from font")
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(_STYLE)
        yield


def new_figure(width: float, height: float, title: str = "", layout: str = "constrained") -> Figure:
    """Empty figure of a size in inches, with its title at the left.

    The constrained layout cuts nothing off, but is slow with many panels.
    """
    figure = Figure(figsize=(width, height), dpi=DPI, layout=layout)  # type: ignore[arg-type]
    if title:
        figure.suptitle(plain(title), x=0.01, ha="left")
    return figure


@style()
def to_png(figure: Figure) -> bytes:
    """PNG of a figure, the same bytes each time; 256 colours make it a third of the size."""
    canvas: Any = FigureCanvasAgg(figure)
    canvas.draw()  # once: savefig would draw twice where there is a layout
    size = canvas.get_width_height()
    drawn = Image.frombuffer("RGBA", size, canvas.buffer_rgba()).convert("RGB")
    few = drawn.quantize(256, Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
    packed = io.BytesIO()
    few.save(packed, "png", compress_level=6)
    return packed.getvalue()


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
