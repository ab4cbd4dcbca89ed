"""Jobs on the workers of a dask.distributed cluster, which share no files with this machine.

A worker gets a test's trace and settings; it sends small messages of its progress, and at the end
the bytes of the files that it made. Both ends must trust each other: dask.distributed unpickles
what they send.
"""
