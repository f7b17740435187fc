"""Simulated serial bus servos on a pseudo-terminal."""
