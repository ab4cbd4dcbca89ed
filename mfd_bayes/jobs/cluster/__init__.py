"""Tests on the workers of a dask.distributed cluster, which share no files with this machine.

What goes to a worker is a test's trace and settings; what comes back are the bytes of the files
that it made, and on the way there small messages of where it stands. Both ends must trust each
other: dask.distributed unpickles what they send.
"""
