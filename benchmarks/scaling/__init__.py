"""How time and memory grow with samples, walkers, parameters and tests."""
