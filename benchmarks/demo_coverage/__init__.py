"""How often the demo's 95 % intervals hold the true value."""
