"""Rows of samples out of frames."""
