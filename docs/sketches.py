"""The two drawings of the documentation that no page computes: the damper, and the rooms.

`python docs/sketches.py docs/pages/assets` writes damper.svg and rooms.svg into that folder.
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.patches import Rectangle

import mfd_bayes as mb

DAMPER = {  # kip, inch and second; friction at one actuation
    "sigma0": 25.0, "sigma1": 0.02, "sigma2": 0.015, "v_s": 0.4,
    "Fs_fwd": 1.5, "Fc_fwd": 1.3, "Fs_bwd": 1.8, "Fc_bwd": 1.6,
    "k2": 0.6, "k3": 12.0, "d2": 0.25, "d3": 0.15, "gamma1": 1.0, "gamma2": 0.02,
}  # fmt: skip
COLOURS = {1: "tab:blue", 2: "tab:orange", 3: "tab:red"}

ROOMS = (  # a line for each step of the way, with what it hands on
    (("records", "a file becomes a Record and a Trace"), ("friction", "a motion becomes a force")),
    (("store", "files, whole or not there"), ("jobs", "processes, cluster")),
    (("calibration", "one test becomes draws"),),
    (("population", "all tests become laws, scatter and bands"),),
    (("planning", "which test next"), ("response", "a building in an earthquake")),
    (("campaign", "the campaign file"), ("runs", "the run folder")),
    (("evaluation", "scores, checks, data sheet, verdict"),),
    (("reporting", "figures, tables, pages"),),
    (("pipeline", "a function for each command"),),
    (("cli", "what a person types and sees"),),
)


def draw_damper() -> plt.Figure:
    """The damper as rod, gap, build-up spring and friction, beside the loop that it makes."""
    figure, (scheme, loop) = plt.subplots(1, 2, figsize=(9, 3.4), width_ratios=(1.25, 1))
    scheme.set(xlim=(0, 10), ylim=(0, 5), aspect="equal")
    scheme.axis("off")
    line = {"color": "black", "lw": 2, "solid_capstyle": "round"}
    scheme.plot([0.9, 2.6], [2.2, 2.2], **line)  # rod
    scheme.plot([2.6, 2.6, 2.6], [1.4, 2.2, 3.0], **line)
    scheme.plot([3.4, 3.4], [1.4, 3.0], **line)  # beyond the gap
    scheme.annotate("", (3.4, 1.2), (2.6, 1.2), arrowprops={"arrowstyle": "<->"})
    scheme.text(3.0, 0.65, "gap\n$D = d_2 + d_3$", ha="center", va="center")
    x = np.linspace(3.4, 5.6, 200)
    inside = (x > 3.8) & (x < 5.2)
    spring = np.where(inside, 0.35 * np.sin((x - 3.8) / 1.4 * 10 * np.pi), 0.0)
    scheme.plot(x, 2.2 + spring, color=COLOURS[3], lw=2)
    scheme.text(4.5, 2.95, "build-up, $k_3$", ha="center", color=COLOURS[3])
    scheme.add_patch(Rectangle((5.6, 1.6), 1.8, 1.2, facecolor="lightsteelblue", edgecolor="k"))
    scheme.text(6.5, 2.2, "shoes", ha="center", va="center")
    scheme.plot([5.0, 8.0], [1.6, 1.6], **line)
    for at in np.arange(5.1, 8.1, 0.35):
        scheme.plot([at, at - 0.25], [1.6, 1.3], color="black", lw=1)
    scheme.text(6.5, 0.85, "drum: friction $F_c$, $F_s$", ha="center", color=COLOURS[1])
    scheme.annotate("", (6.5, 2.85), (6.5, 4.0), arrowprops={"arrowstyle": "-|>", "lw": 2})
    scheme.text(6.5, 4.2, "actuation $p$ (pressure or tension)", ha="center")
    scheme.annotate("", (1.9, 2.75), (0.9, 2.75), arrowprops={"arrowstyle": "-|>", "lw": 1.5})
    scheme.text(1.4, 3.0, "$x(t)$, $F(t)$", ha="center")

    model = mb.ThreeStage()
    theta = np.array([[DAMPER[name] for name in model.parameters]])
    time = np.linspace(0.0, 6.0, 1801)
    trace = mb.Trace.from_arrays(time, np.sin(np.pi * time), actuation=1.0)
    force, stage = model.force(theta, trace)[0], model.stages(theta, trace)[0]
    last = time > 4.0
    for number, name in ((2, "stick (stage 2)"), (3, "build-up (3)"), (1, "slip (1)")):
        shown = np.where(last & (stage == number), force, np.nan)
        loop.plot(trace.displacement, shown, color=COLOURS[number], lw=2, label=name)
    loop.set(xlabel="displacement, in", ylabel="force, kip")
    loop.legend(fontsize=8, loc="center")
    figure.tight_layout()
    return figure


def draw_rooms() -> plt.Figure:
    """The rooms from the first to the last; each may import from those above it."""
    figure, axes = plt.subplots(figsize=(8.5, 6))
    axes.set(xlim=(0, 10), ylim=(0, len(ROOMS)))
    axes.axis("off")
    for row, rooms in enumerate(ROOMS):
        top, width = len(ROOMS) - row, 9.0 / len(rooms)
        for column, (name, text) in enumerate(rooms):
            left = 0.7 + column * width
            axes.add_patch(
                Rectangle((left, top - 0.82), width - 0.15, 0.7, facecolor="lightsteelblue")
            )
            axes.text(left + 0.12, top - 0.47, name, weight="bold", va="center", fontsize=10)
            axes.text(left + width - 0.27, top - 0.47, text, va="center", ha="right", fontsize=9)
    arrow = {"arrowstyle": "-|>", "lw": 1.5}
    axes.annotate("", (0.35, len(ROOMS) - 0.1), (0.35, 0.1), arrowprops=arrow)
    axes.text(0.12, len(ROOMS) / 2, "imports from", rotation=90, va="center", ha="center")
    figure.tight_layout()
    return figure


def write(folder: Path) -> None:
    """Write both drawings into a folder."""
    with plt.rc_context({"svg.hashsalt": "mfd_bayes", "axes.spines.top": False}):
        for name, draw in (("damper", draw_damper), ("rooms", draw_rooms)):
            figure = draw()
            figure.savefig(folder / f"{name}.svg", metadata={"Date": None})
            plt.close(figure)


if __name__ == "__main__":
    write(Path(sys.argv[1]))
