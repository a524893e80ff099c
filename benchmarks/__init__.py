"""Figures that others can check: accuracy against known truth, speed against peers in the same run."""
