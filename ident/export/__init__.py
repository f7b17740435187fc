"""Exports of the physically consistent model: URDF, MJCF, ROS 2 inertial parameters, Pinocchio."""
