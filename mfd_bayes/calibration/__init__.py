"""One test: priors, likelihood, posterior, its mode and its draws."""
