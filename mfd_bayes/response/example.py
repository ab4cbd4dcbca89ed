"""A first building file, to be changed by its user."""

from __future__ import annotations

EXAMPLE = """\
# A building with dampers, for: mfd-bayes respond OUT --building building.toml --ground …
# Every quantity has its unit. Change what is here; what is left out has a sensible default.

[building]
title = "Three storeys"
damping = { kind = "rayleigh", ratio = "2 %", modes = [1, 2] }   # or kind = "modal", or "none"

# The storeys from the lowest up: the floor above each, as weight or mass.
[[storey]]
weight = "30 kip"
height = "144 in"
stiffness = "40 kip/in"
# yield_force = "60 kip"        # elastic without it
# dashpot = "0.1 kip*s/in"

[[storey]]
weight = "30 kip"
height = "144 in"
stiffness = "40 kip/in"

[[storey]]
weight = "25 kip"
height = "144 in"
stiffness = "30 kip/in"

# Dampers: those of one place together. Actuation: a pressure or a force, as in the campaign.
[[damper]]
storey = 1                      # or between = [2, 0]: floors, 0 is the ground
count = 1
actuation = "1000 psi"          # or one of each: ["900 psi", "1100 psi"]
# actuation = { file = "pressure.csv", column = "pressure_psi", unit = "psi" }
geometry = 1.0                  # travel of the damper over the storey drift
brace = "rigid"                 # or a stiffness in series: "500 kip/in"

[[damper]]
storey = 2
actuation = "1000 psi"

[[damper]]
storey = 3
actuation = "1000 psi"

# How probable is it that these are passed?
[limits]
drift = "1 %"
acceleration = "0.5 g"
"""
