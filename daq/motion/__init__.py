"""Motions from formulas and files, and the player that sends them."""
