"""Mistakes of a recording or a robot file that a refit reveals: signs, columns, gains, gravity."""
