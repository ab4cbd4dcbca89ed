"""The page of a building's response, in both systems of units."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from markupsafe import Markup

from mfd_bayes.errors import BuildingError
from mfd_bayes.reporting.html import either, embedded_picture, page_environment, policy_of
from mfd_bayes.reporting.response_tables import shown_unit
from mfd_bayes.reporting.symbols import number, unit_text
from mfd_bayes.response.result import Passing, Row
from mfd_bayes.response.variance_shares import Shares
from mfd_bayes.runs.unit_system import SYSTEMS


@dataclass(frozen=True)
class ResponseView:
    """What the page shows.

    Attributes
    ----------
    title, about : str
    mark : {"pass", "care", "fail"}
    verdict, remarks : tuple of str
    rows : tuple of Row
    limits : tuple of Passing
    shares : tuple of Shares
        For each quantity and ground motion.
    sweep : str
        The best actuation in a sentence; empty without a sweep.
    headline : str
        The verdict in a few words.

    Raises
    ------
    BuildingError
        When there is nothing to show: every draw ran away under every ground motion, and there is
        no sweep.
    """

    title: str
    about: str
    mark: str
    verdict: tuple[str, ...]
    remarks: tuple[str, ...]
    rows: tuple[Row, ...]
    limits: tuple[Passing, ...]
    shares: tuple[Shares, ...]
    sweep: str
    grounds: tuple[str, ...]
    dampers: int
    metric: bool
    provenance: Mapping[str, object]
    headline: str = ""

    def __post_init__(self) -> None:
        if not self.rows and not self.sweep:
            raise BuildingError(
                f"every draw diverged under {', '.join(self.grounds)}: there is no response to "
                "write; expected ground motions, and a building, that its dampers can bear"
            )

    @property
    def sources(self) -> list[str]:
        """All sources of variance, in their order."""
        return list(dict.fromkeys(name for one in self.shares for name in one.shares))


def render_response(view: ResponseView, images: Mapping[str, bytes]) -> str:
    """HTML of the page; `images` are PNGs by "profile_us", "profile_si" and so on."""
    environment = page_environment(SYSTEMS)
    environment.filters["shown"] = _shown
    pictures = {name: embedded_picture(name, png) for name, png in images.items()}
    template = environment.get_template("response.html.j2")
    return template.render(view=view, systems=SYSTEMS, pictures=pictures, policy=policy_of())


def _shown(value: float, unit: str, *, bare: bool = False) -> Markup:
    """A figure with its unit, in both systems."""
    if not math.isfinite(value):
        return Markup("–")
    texts = []
    for system in SYSTEMS:
        name, by = shown_unit(unit, system)
        texts.append(number(by * value, 3) + ("" if bare else f" {unit_text(name) or name}"))
    return either(*texts)
