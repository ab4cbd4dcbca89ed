"""Questions to a finished run: a folder for each, with its options, computation, table and page."""
