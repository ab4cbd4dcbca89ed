"""Pictures of docs/pages/slip.md: a gap that closes at speed, and an earthquake by its start.

    python -m benchmarks.slip.figures

takes some minutes, and writes two files of docs/pages/assets.
"""

from benchmarks import common  # isort: skip  (one thread, before numpy)

import matplotlib.pyplot as plt
import numpy as np

from benchmarks.slip.run import HARMONIC, by_start, fit, mechanism, read, thinned

ASSETS = common.PROJECT / "docs" / "pages" / "assets"
MODELS = {"backlash": "C0", "self_energising": "C3"}
CLOSINGS = {"36lb_0.10Hz_1.0in_SI": (30.0, 38.0), "36lb_1.00Hz_1.0in": (3.0, 3.8)}
QUAKE, SHOWN = "36lb_KocaeliDBE", (6.0, 14.0)
STYLE = {"figure.constrained_layout.use": True, "axes.spines.top": False, "font.size": 9}
STYLE |= {"axes.spines.right": False, "axes.grid": True, "grid.alpha": 0.3, "savefig.dpi": 120}


def main():
    options = common.begin(common.parser_of(__doc__, data=True))
    records = thinned(read(options.data))
    fits = {}
    for name in MODELS:
        force, rng = mechanism(name), np.random.default_rng(options.seed)
        fitted = [records[key] for key in HARMONIC]
        fits[name] = force, *fit(force, fitted, np.zeros(len(force.names)), rng)[:2]
    plt.rcParams.update(STYLE)
    figure, axes = plt.subplots(1, 2, figsize=(7.5, 3.0), sharey=True)
    for axis, (key, span) in zip(axes, CLOSINGS.items(), strict=True):
        t, _, measured = records[key]
        axis.plot(t, measured, "k", lw=0.8, label="measured")
        for name, colour in MODELS.items():
            f, error = by_start(*fits[name], records[key])
            axis.plot(t, f[:, np.argmin(error)], colour, lw=1.1, label=name)
        axis.set(xlim=span, xlabel="time, s", title=key.split("_")[1].replace("Hz", " Hz"))
    axes[0].set_ylabel("force, kip")
    axes[0].legend(fontsize=8)
    figure.savefig(ASSETS / "slip-closing.png")
    t, _, measured = records[QUAKE]
    f, error = by_start(*fits["backlash"], records[QUAKE])
    figure, axis = plt.subplots(figsize=(7.5, 3.0))
    axis.fill_between(t, f.min(axis=1), f.max(axis=1), color="C0", alpha=0.2, label="any start")
    axis.plot(t, measured, "k", lw=0.8, label="measured")
    axis.plot(t, f[:, np.argmin(error)], "C0", lw=1.1, label="backlash, its start fitted")
    axis.set(xlim=SHOWN, xlabel="time, s", ylabel="force, kip")
    axis.legend(fontsize=8)
    figure.savefig(ASSETS / "slip-start.png")


if __name__ == "__main__":
    main()
