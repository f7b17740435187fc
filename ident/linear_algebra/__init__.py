"""Matrices: triangular factors of data that stream by, and which columns are independent."""
