"""Simulated CAN motors: Damiao, RobStride, CubeMars, moteus, ODrive."""
