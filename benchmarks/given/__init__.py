"""Whether predictions given a first part of a record are right, and quick enough to follow one."""
