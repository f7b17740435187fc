"""Least squares on the whole arm's energy or its derivative, one scalar equation per row."""
