"""Table, figure and page of compared devices."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from mfd_bayes.applications.acceptance.judgement import Acceptance
from mfd_bayes.reporting import symbols
from mfd_bayes.reporting.figures import new_figure, style
from mfd_bayes.reporting.page import environment, picture, policy_of
from mfd_bayes.reporting.symbols import (
    plain,
)
from mfd_bayes.reporting.tables import (
    to_units,
)
from mfd_bayes.runs.unit_system import UnitSystem
from mfd_bayes.units import in_digits

if TYPE_CHECKING:
    import pandas as pd


def acceptance_table(devices: Sequence[Acceptance], system: UnitSystem) -> pd.DataFrame:
    """A row for each device and quantity, in the units of a system."""
    import pandas as pd

    frames = []
    for device in devices:
        head = {
            "device": device.device,
            "records": "; ".join(c.record.path.name for c in device.comparisons),
            "device_verdict": device.verdict,
            "device_p_value": device.p_value,
            "device_p_batch": device.p_batch,
        }
        rows = device.rows.rename(columns={"p_value": "p_adjusted"})
        frames.append(pd.DataFrame([head] * len(rows)).join(rows.reset_index(names="name")))
    return to_units(pd.concat(frames, ignore_index=True), system)


# --- devices that are compared with the others

VERDICTS = {"within the limit": "#2e7d32", "beyond the limit": "#c62828", "differs": "#c62828"}


@style()
def draw_batch(devices: Sequence[Acceptance]) -> Any:
    """Effect of every quantity of every device, with its interval and the limits."""
    import pandas as pd

    table = pd.concat([d.rows for d in devices], keys=range(len(devices)))
    names = [name for name in table.index.unique(1) if name != "loop"]
    width = min(2.0 + 1.15 * len(names), 14.0)
    figure = new_figure(width, 1.6 + 0.24 * len(devices), "Devices against the others")
    grid = figure.subplots(1, len(names), sharey=True, squeeze=False)[0]
    for axes, name in zip(grid, names, strict=True):
        effects = table.xs(name, level=1)
        colours = [VERDICTS.get(verdict, "#b8860b") for verdict in effects["verdict"]]
        axes.hlines(effects.index, effects["effect_lower"], effects["effect_upper"], colors=colours)
        axes.scatter(effects["effect"], effects.index, s=16, c=colours)
        row = effects.iloc[0]
        for limit in (row["limit"], -row["limit"]) if np.isfinite(row["limit"]) else ():
            axes.axvline(limit, color="#666666", linestyle="--", linewidth=0.8)
        axes.axvline(0.0, color="#666666", linewidth=0.6)
        axes.set_title(f"{row['quantity']}\n{row['direction']}", fontsize=7)
        axes.set_xlabel("%", fontsize=7)
        axes.tick_params(labelsize=7)
    grid[0].set_yticks(range(len(devices)))
    grid[0].set_yticklabels([plain(f"{d.device}: {d.verdict}") for d in devices])
    grid[0].set_ylim(len(devices) - 0.5, -0.5)
    return figure


# --- devices that are compared with the others

LOOPS = 2
"""Most loops on the page of a device."""


def acceptance_page(
    device: Acceptance, facts: Mapping[str, str], today: str, batch: int, system: UnitSystem
) -> str:
    """HTML of the page of a device, which prints on one sheet of A4."""
    from mfd_bayes.reporting.figures import draw_loops, to_png

    pictures = []
    for comparison in device.comparisons[:LOOPS]:
        data = comparison.trace, [comparison.expected.fan]
        png = to_png(draw_loops(comparison.record.path.name, *data, system))
        pictures.append(picture("", png)["uri"])
    return (
        environment()
        .get_template("acceptance.html.j2")
        .render(
            device=device,
            about=facts,
            rows=to_units(device.rows, system).to_dict("records"),
            number=_number,
            risk=_risk,
            unit_text=symbols.unit_text,
            pictures=pictures,
            batch=batch,
            today=today,
            policy=policy_of(),
        )
    )


def _risk(row: Mapping[str, Any]) -> float:
    """Probability that the verdict on a quantity is wrong; NaN where it says neither."""
    acceptance, rejection = row["p_wrong_acceptance"], row["p_wrong_rejection"]
    return float(acceptance if math.isfinite(acceptance) else rejection)


def _number(value: float, form: str = "") -> str:
    """A number of the page's table, with three digits or in a format of Python's; "" for none."""
    if not math.isfinite(value):
        return ""
    return f"{value:{form}}" if form else in_digits(value, 3)
