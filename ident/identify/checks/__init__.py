"""Checks of an identification, which decide its verdict."""
