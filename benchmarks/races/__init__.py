"""How long a person waits for a posterior by each sampler of the field, and whether it is right."""
