"""Calibrations of records that a run's own posterior has made: `mfd-bayes rehearse`."""
