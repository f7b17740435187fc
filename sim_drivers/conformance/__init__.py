"""Conformance of a driver: what every driver has to keep, tried on its simulated device in simulated time."""
