"""The conformance suite for drivers: `class TestMyBus(DriverConformance)` with a bench is all that it needs.

docs/drivers.md builds a driver that passes it.
"""

from sim_drivers.conformance.bench import Bench as Bench
from sim_drivers.conformance.bench import declared_bench as declared_bench
from sim_drivers.conformance.points import POINTS as POINTS
from sim_drivers.conformance.points import check_point as check_point
from sim_drivers.conformance.requirement import ConformanceError as ConformanceError
from sim_drivers.conformance.simulated_clock import SimulatedClock as SimulatedClock
from sim_drivers.conformance.simulated_clock import simulated_time as simulated_time
from sim_drivers.conformance.suite import DriverConformance as DriverConformance
