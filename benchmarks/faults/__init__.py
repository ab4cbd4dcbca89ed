"""Which random faults in the whole package the fast tests notice."""
