"""Design of excitation trajectories: motions that make an arm's parameters identifiable within its limits."""
