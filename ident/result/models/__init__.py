"""The models that results hand out: torques, gravity, simulation, exports."""
