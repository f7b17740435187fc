"""The clock of the conformance suite is that of all tests."""

from __future__ import annotations

from sim_drivers.conformance.simulated_clock import DAY as DAY
from sim_drivers.conformance.simulated_clock import START as START
from sim_drivers.conformance.simulated_clock import SimulatedClock as SimulatedClock
from sim_drivers.conformance.simulated_clock import VirtualBus as VirtualBus
from sim_drivers.conformance.simulated_clock import simulated_time as simulated_time
