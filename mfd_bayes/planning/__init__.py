"""Which test to make next: what a test that is not yet made is expected to tell.

Goal and simulated tests come from one set of draws of the population; what a test would leave
unknown is found by regression of the goal on the summaries of its simulated records.
"""
