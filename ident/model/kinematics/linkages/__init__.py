"""General closed loops, solved numerically; imported only for robot files that have such loops."""
