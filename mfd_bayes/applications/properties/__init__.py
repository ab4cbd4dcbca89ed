"""The data sheet and bounding properties for design."""
