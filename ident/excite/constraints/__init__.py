"""Constraints of a designed motion: limits of joints and torques, floor, obstacles, self-collision."""
