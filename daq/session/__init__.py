"""A session: sources, clocks, supervisor, and the stop on every exit path."""
