"""The robot file: the description of an arm."""
