"""The robot file: what dynid knows of an arm."""
