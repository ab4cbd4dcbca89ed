"""Is a device like the calibrated ones: `mfd-bayes accept`."""
