"""How well tests are predicted that a fit has not seen."""
