"""A damper that is stepped with its valve closed at the first sample, or open from the start."""

import numpy as np


def late_forces(model, theta, trace, first, reference=None):
    """Forces of the later half of a motion at 0.5 ksi, but for the first sample's actuation."""
    state, found = model.start(theta, reference_actuation=reference), []
    for i, (x, v) in enumerate(zip(trace.displacement, trace.velocity, strict=True)):
        actuation = 0.5 if i else first
        force, state = model.step(state, x, v, trace.time[1] - trace.time[0], actuation)
        found.append(force[0])
    return np.array(found[trace.samples // 2 :])
