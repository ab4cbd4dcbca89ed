"""Whether every damaged input file ends in a result or in one clear error message."""
