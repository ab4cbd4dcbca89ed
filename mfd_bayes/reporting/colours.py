"""Colours of figures and of the interactive plot, each with one meaning."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from mfd_bayes.population.bands import KIND_NAMES

# Palette of Okabe and Ito, which colour-blind readers can tell apart.
DATA = "#1b1b1b"
ORANGE = "#E69F00"
BLUE = "#0072B2"
GREEN = "#009E73"
VERMILLION = "#D55E00"
PURPLE = "#CC79A7"
SKY = "#56B4E9"
PRIOR = "#9a9a9a"
POSTERIOR = BLUE
TRUTH = VERMILLION
VALIDATE = "#a3457c"
CHAINS = (BLUE, ORANGE, GREEN, PURPLE, SKY, VERMILLION, "#555555", "#b8a600")

# For each kind of band: wide band, narrow band, median. They are opaque, so that overlapping
# branches of a loop do not make a darker shade.
BANDS = {
    "observation": ("#d5e7f4", "#a5cce8", BLUE),
    "new_test": ("#cdeae0", "#93d2bd", GREEN),
    "device": ("#f3e3ed", "#e0bcd3", PURPLE),
    "this_test": ("#f6c877", "#e08f1f", VERMILLION),
    "prior": ("#e6e6e6", "#c6c6c6", "#6f6f6f"),
}
BAND_NAMES: Mapping[str, str] = MappingProxyType({**KIND_NAMES, "prior": "what the priors allow"})
