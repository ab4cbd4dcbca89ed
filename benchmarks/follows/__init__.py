"""Whether a test is predicted better if it is known where the test before it ended."""
