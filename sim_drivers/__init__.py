"""Robots that do not exist: simulated measurements with a known truth."""
