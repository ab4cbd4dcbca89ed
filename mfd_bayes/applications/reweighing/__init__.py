"""A finished run under another prior file: `mfd-bayes reweigh`."""
