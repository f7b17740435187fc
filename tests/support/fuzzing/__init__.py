"""Damaged input files, the commands that read them, and what a command may do with them."""
