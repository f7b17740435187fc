"""What a designed motion must keep: limits of joints and torques, floor, obstacles, self-collision."""
