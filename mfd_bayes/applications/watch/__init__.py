"""A test that is followed while it runs: `mfd-bayes watch`."""
