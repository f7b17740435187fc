"""Live view of a recording."""
