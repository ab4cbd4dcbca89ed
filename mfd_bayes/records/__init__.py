"""From files to records to traces."""
