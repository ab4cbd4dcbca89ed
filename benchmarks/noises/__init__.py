"""Real tests under every noise model, and what their runs say of it."""
