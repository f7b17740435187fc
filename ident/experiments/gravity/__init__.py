"""Gravity from slow passes through poses in both directions."""
