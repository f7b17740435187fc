"""A simulated CAN bus: its load, faults, and an slcan adapter."""
