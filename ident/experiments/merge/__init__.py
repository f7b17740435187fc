"""One model from several experiments."""
