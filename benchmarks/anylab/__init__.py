"""Devices of any size, from loggers' files to a report."""
