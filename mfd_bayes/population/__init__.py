"""All tests of a campaign become laws, scatter and bands: a linear mixed model."""
