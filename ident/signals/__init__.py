"""Preprocessing: gap-free segments of filtered signals on a uniform grid, made of a recording."""
