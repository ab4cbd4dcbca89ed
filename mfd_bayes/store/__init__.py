"""Bytes on a disk: a file is written whole, or it is not there."""
