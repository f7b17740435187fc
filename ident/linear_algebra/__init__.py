"""Triangular factors of streamed matrices, and independent columns."""
