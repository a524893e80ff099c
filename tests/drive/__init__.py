"""Tests of the wing that drives."""
