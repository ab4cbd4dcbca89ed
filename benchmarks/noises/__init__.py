"""Mistakes planted into real sessions, and who names them."""
