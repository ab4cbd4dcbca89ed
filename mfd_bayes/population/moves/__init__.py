"""The moves of a sweep: each proposes new values for some coordinates of the chains.

A move is a function `move(joint, chains, rng, …)`. It changes the chains in place, leaves the joint
posterior as it is, and returns what was accepted, by name.
"""
