"""The force band of a motion: `mfd-bayes predict`."""
