"""Equilibrium of a clamped beam: the balance, Newton's method, continuation in the load, and its derivatives."""
