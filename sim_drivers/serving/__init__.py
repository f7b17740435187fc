"""Serving simulated devices: `dynid sim`."""
