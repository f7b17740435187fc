"""A simulated serial thermometer."""
