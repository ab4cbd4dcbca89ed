"""Devices of a user's own, each one file, from synthetic records to what is predicted."""
