"""All tests together: pressure laws, scatter and force bands."""
