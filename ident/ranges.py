"""What each quantity of an identification or an excitation can sensibly be; see `drivers.core.ranges`."""

from __future__ import annotations

from drivers.core.ranges import Range

RECORDED_POSITION = Range(-1e6, 1e6, "rad or m")
RECORDED_VELOCITY = Range(-1e5, 1e5, "rad/s or m/s")
RECORDED_TORQUE = Range(-1e8, 1e8, "N·m or N")
SMOOTHING = Range(0.0, 10.0, "rad/s")
PRESLIDING_TRAVEL = Range(1e-6, 1.0, "rad or m")
SEARCH_TIME = Range(1e-3, 604_800.0, "s")
"""A week."""
SEED = Range(0, 2**63 - 1)
POPULATION = Range(1, 100_000)
"""Size of a swarm, and of its memeplexes."""
GENERATIONS = Range(1, 1_000_000)
LEARNING_FACTOR = Range(0.0, 100.0)
"""Factor of a swarm's moves towards good points."""
FRICTION_SHARE = Range(1e-3, 10.0)
"""Largest torque of a friction term over the joint's torque limit."""
BOX_SHARE = Range(1e-6, 1e3)
"""Half of a search range over the size of its middle."""
UNIT_SPREAD = Range(0.0, 2.0)
"""Standard deviation of logarithms of parameters, from one unit of a type to the next."""
RESULT_VALUE = Range(-1e100, 1e100)
"""Any number of a result: a parameter that is hardly excited may be huge, but not so that squares overflow."""
