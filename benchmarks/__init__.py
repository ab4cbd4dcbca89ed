"""What is measured by hand: a folder for each question, with its command and its table.

Run from the project's folder, such as `python -m benchmarks.forward.run --quick`.
"""
