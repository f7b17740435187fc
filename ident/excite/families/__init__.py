"""Families of excitation motions."""
