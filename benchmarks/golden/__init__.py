"""Numbers that a rebuilding must not change unnoticed."""
