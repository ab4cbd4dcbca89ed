"""A run for other programs: `mfd-bayes export`, `draws` and `serve`."""
