"""Adapters between dynid and a robot's wire: one a bus, and the ground floor that all packages share."""
