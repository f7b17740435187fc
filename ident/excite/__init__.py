"""Design of excitation trajectories: motions that tell an arm's parameters apart within its limits."""
