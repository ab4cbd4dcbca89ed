"""How long the computation of a force takes, beside other implementations that must agree."""
