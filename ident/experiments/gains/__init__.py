"""Drive gains, from a load of known mass."""
