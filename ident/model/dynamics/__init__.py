"""Dynamics of an arm with given parameters: torques, inertia, energies, Jacobians."""
