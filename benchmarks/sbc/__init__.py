"""Whether posteriors of one test are right on average, by simulation-based calibration."""
