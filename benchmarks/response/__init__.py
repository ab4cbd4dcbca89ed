"""How exactly, and how fast, buildings with dampers are stepped."""
