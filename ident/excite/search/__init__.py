"""Search for the best feasible motion of a family within a budget of time or of starts."""
