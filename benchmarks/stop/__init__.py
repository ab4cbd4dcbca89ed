"""When a test is long enough."""
