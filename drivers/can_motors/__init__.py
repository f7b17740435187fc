"""Motors on CAN that people buy: Damiao, RobStride, CubeMars, moteus, ODrive."""
