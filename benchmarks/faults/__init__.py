"""Which random faults in the package the tests notice."""
