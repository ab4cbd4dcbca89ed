"""How long a person waits for a posterior, by ours, emcee and NUTS."""
