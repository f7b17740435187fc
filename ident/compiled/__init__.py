"""What NumPy and Pinocchio are too slow for, in C: built once per computer, and not needed."""
