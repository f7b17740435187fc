"""What is said to do about a limit that was passed."""

from __future__ import annotations

import pytest
from simulated_clock import SimulatedClock

from daq.recording.quality.clocks import ClockLog
from daq.session.course import Course
from daq.session.supervisor import CURES, Breach


@pytest.mark.parametrize("what", [*(name for name in CURES if name != "stuck"), "stuck torque"])
def test_each_limit_has_a_cure_and_soon_after_a_stall_that_is_what_is_named(clock: SimulatedClock, what: str) -> None:
    breach, course = Breach(what, "elbow", 152.3, 150.0, 1.0, "N·m"), Course(clock, ClockLog())
    assert course.cure(breach) == breach.cure == CURES[what.partition(" torque")[0]]
    course.resumed = clock.now() - 0.3
    assert course.cure(breach).startswith("0.3 s before, the arm was resumed after a stall of this computer: ")
    clock.sleep(5.0)
    assert course.cure(breach) == breach.cure
