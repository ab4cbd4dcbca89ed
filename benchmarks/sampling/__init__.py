"""How many effective draws a second the sampler gives, and whether they are right."""
