"""Whether predicted bands hold the force of tests that were not used."""
