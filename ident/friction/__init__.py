"""Friction: the table of its terms, which of them motors have, and the one solver of their shapes."""
