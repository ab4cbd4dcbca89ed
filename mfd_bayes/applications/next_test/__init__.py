"""Which test to make next: `mfd-bayes next`."""
