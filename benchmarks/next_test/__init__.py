"""What advice on the next test is worth: see run.py."""
