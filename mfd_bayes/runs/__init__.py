"""A run folder: its layout, manifest and lock, and what is in it."""
