"""Built-in arms of which no two differ in the size of their links alone: for tests whose cases cost seconds."""

from __future__ import annotations

from daq.robot.loader import builtin_robots

LIKE_ANOTHER = {"ur3e", "ur16e", "ur20", "openarm", "koch", "moteus_rig"}  # as ur5e, ur10e, panda, so101, up6

ARM_KINDS = [name for name in builtin_robots() if name not in LIKE_ANOTHER]
