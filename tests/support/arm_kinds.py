"""Built-in arms of which no two differ in the size of their links alone: for tests whose cases cost seconds."""

from __future__ import annotations

from daq.robot.loader import builtin_robots

LIKE_ANOTHER = {"ur3e", "ur16e", "ur20", "openarm", "koch"}  # as ur5e, ur10e, panda and so101

ARM_KINDS = [name for name in builtin_robots() if name not in LIKE_ANOTHER]
