"""Rows of samples, one per SYNC."""
