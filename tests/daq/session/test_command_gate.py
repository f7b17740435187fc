"""The command gate: nothing that breaks a limit reaches the driver, whatever plan, timing and measurement are."""

from __future__ import annotations

import numpy as np
import pytest
from each import each
from hypothesis import example, given, settings
from hypothesis import strategies as st
from simulated_clock import simulated_time

from daq.motion.limits import check_limits
from daq.motion.player import STALL_LIMIT, MotionSequence, Player, skip_limit
from daq.motion.trajectories import FourierSeries, PointToPoint, RestToRest, slow_move
from daq.robot.schema import JointLimits
from daq.session.command_gate import FRESH, MARGIN, CommandGate, GateLimits
from drivers.core.clock import Clock
from drivers.core.errors import SafetyStopError, UsageError

JOINTS = (
    JointLimits(name="shoulder", position=(-3.0, 3.0), velocity=2.0, acceleration=8.0),
    JointLimits(name="elbow", position=(-2.0, 2.0), velocity=1.0, acceleration=5.0),
)
LIMITS = GateLimits.of_joints(JOINTS)
PERIOD = 0.002


class Moment(Clock):
    """A clock that stands until it is set."""

    def __init__(self) -> None:
        super().__init__()
        self.time = 100.0

    def now(self) -> float:
        return self.time


class Bench:
    """A gate with an arm that is where it was commanded to, unless told otherwise."""

    def __init__(self, period: float = PERIOD) -> None:
        self.clock, self.period = Moment(), period
        self.sent: list[np.ndarray] = []
        self.due: list[float] = []
        self.noted: list[tuple[float, float]] = []
        self.gate = CommandGate(lambda position, _: self.sent.append(position), self._note, LIMITS, period, self.clock)
        self.gate.measured(self.clock.now(), np.zeros(2))

    def _note(self, now: float, position: np.ndarray) -> None:
        self.noted.append((now, float(position[0])))

    def send(self, shoulder: float, elbow: float = 0.0, wait: float | None = None, late: float = 0.0) -> None:
        due = (self.due[-1] if self.due else self.clock.time) + (self.period if wait is None else wait)
        self.clock.time = max(self.clock.time, due + late)
        position = np.array([shoulder, elbow])
        self.gate.command(position, due)
        self.due.append(due)
        self.gate.measured(self.clock.now(), position)


def at(acceleration: float, ticks: int) -> np.ndarray:
    return 0.5 * acceleration * (PERIOD * np.arange(ticks)) ** 2


def test_a_motion_within_its_limits_passes_and_is_noted() -> None:
    bench = Bench()
    for position in at(7.9, 60):
        bench.send(position, 0.5 * position)
    assert len(bench.sent) == len(bench.noted) == 60


@each(
    ("steps", "said"),
    [
        ([0.0, 0.0, 0.1], "commanded velocity of shoulder: 50 rad/s passes 2.02 rad/s"),
        ([0.0, 0.0, 1e-4], "commanded acceleration of shoulder: 25 rad/s² passes 8.081 rad/s²"),
        ([0.0, 0.0, 3e-5, 1e-4], "commanded acceleration of shoulder: 10 rad/s² passes"),
        ([0.5], "first step of shoulder: 0.5 rad passes 0.004 rad"),
        ([0.0, np.nan], "finite positions"),
        ([0.0, np.inf], "finite positions"),
    ],
)
def test_what_breaks_a_limit_is_not_sent_and_nothing_after_it(steps: list[float], said: str) -> None:
    bench = Bench()
    for step in steps[:-1]:
        bench.send(step)
    with pytest.raises(SafetyStopError) as error:
        bench.send(steps[-1])
    assert said in str(error.value)
    assert len(bench.sent) == len(steps) - 1
    with pytest.raises(SafetyStopError):
        bench.send(0.0)
    assert len(bench.sent) == len(steps) - 1


def test_a_position_beyond_the_joints_range_is_refused() -> None:
    bench = Bench()
    for gate_position in (3.0001, -3.0001):
        bench = Bench()
        bench.gate.measured(bench.clock.now(), np.array([gate_position, 0.0]))
        with pytest.raises(SafetyStopError, match="position of shoulder"):
            bench.send(gate_position)


@each(("waited", "refused"), [(0.045, False), (0.06, True), (2.0, True)])
def test_a_moving_arm_is_not_left_without_commands(waited: float, refused: bool) -> None:
    bench = Bench()
    positions = at(5.0, 50)
    for position in positions:
        bench.send(position)
    if refused:
        bench.gate.measured(bench.clock.now() + waited, positions[-1])
        with pytest.raises(SafetyStopError, match="was without a command"):
            bench.send(positions[-1], wait=waited)
    else:
        bench.send(positions[-1], wait=waited)  # it was held, and starts from rest
        with pytest.raises(SafetyStopError, match="commanded acceleration"):
            bench.send(2.0 * positions[-1] - positions[-2])


@pytest.mark.parametrize("late", [0.0, 0.03])
def test_a_command_that_is_late_counts_from_when_the_one_before_was_due(late: float) -> None:
    bench = Bench()
    for position in at(5.0, 50):
        bench.send(position, late=late)
    with pytest.raises(SafetyStopError, match="was without a command"):
        bench.send(at(5.0, 51)[-1], late=STALL_LIMIT + 3 * PERIOD)


def test_a_command_ahead_of_its_time_and_two_at_once_are_refused() -> None:
    bench = Bench()
    bench.send(0.0)
    with pytest.raises(SafetyStopError, match="before it was due"):
        bench.gate.command(np.zeros(2), bench.clock.time + 0.001)
    bench = Bench()
    for position in at(5.0, 3):
        bench.send(position)
    with pytest.raises(SafetyStopError, match="apart"):
        bench.send(at(5.0, 4)[-1], wait=1e-4)


@pytest.mark.parametrize("age", [0.09, 0.11])
def test_without_a_fresh_measured_position_nothing_is_sent(age: float) -> None:
    bench = Bench()
    bench.send(0.0)
    bench.gate.measured(bench.clock.now() + PERIOD - age, np.zeros(2))
    if age > FRESH:
        with pytest.raises(SafetyStopError, match=r"the measured position is 0\.110 s old"):
            bench.send(0.0)
    else:
        bench.send(0.0)
    unmeasured = CommandGate(
        lambda position, _: bench.sent.append(position), lambda *_: None, LIMITS, PERIOD, bench.clock
    )
    with pytest.raises(SafetyStopError, match="no position of the arm"):
        unmeasured.command(np.zeros(2), bench.clock.now())


def test_an_arm_that_is_elsewhere_is_not_commanded() -> None:
    bench = Bench()
    for position in at(5.0, 100):
        bench.send(position)
    ahead = at(5.0, 102)[-2:]
    bench.gate.measured(bench.clock.now(), np.zeros(2))  # it lags by all that was commanded lately
    bench.send(ahead[0])
    bench.gate.measured(bench.clock.now(), np.array([0.5, 0.0]))
    with pytest.raises(SafetyStopError, match="tracking error of shoulder"):
        bench.send(ahead[1])


@given(
    steps=st.lists(
        st.tuples(
            st.floats(-0.02, 0.02),  # step of the shoulder [rad]
            st.floats(-1e-4, 1e-4),  # of the elbow
            st.floats(-0.5, 30.0),  # time since the last due time [periods]
            st.floats(0.0, 0.2),  # lateness [s]
            st.floats(-0.5, 0.5),  # of the measured position from the command [rad]
        ),
        max_size=60,
    )
)
@example(steps=[(0.0, 0.0, 1.0, 0.0, 0.0), (1e-5, 0.0, 1.0, 0.0, 0.0), (1e-4, 0.0, 4.0, 0.0, 0.0)])
def test_whatever_is_sent_keeps_the_limits_as_the_arm_sees_them(
    steps: list[tuple[float, float, float, float, float]],
) -> None:
    bench = Bench()
    position = np.zeros(2)
    for shoulder, elbow, wait, late, away in steps:
        position = position + np.array([shoulder, elbow])
        before = len(bench.sent)
        try:
            bench.send(*position, wait=wait * PERIOD, late=late)
        except SafetyStopError:
            assert len(bench.sent) == before
            break
        bench.gate.measured(bench.clock.now(), position + away)
    due, sent = np.array(bench.due), np.array(bench.sent)
    assert len(due) == len(sent)
    held, velocity, time = (1 + skip_limit(PERIOD)) * PERIOD + 1e-6, np.zeros(2), PERIOD
    for index in range(1, len(sent)):
        step, dt = sent[index] - sent[index - 1], due[index] - due[index - 1]
        if not step.any() and not velocity.any():
            time = PERIOD
            continue
        assert dt <= STALL_LIMIT + 2 * PERIOD + 1e-9
        if dt > held:
            velocity, dt, time = np.zeros(2), PERIOD, PERIOD
        assert np.all(np.abs(step) / dt <= LIMITS.velocity * (1 + MARGIN) + 1e-5)
        change = np.abs(step / dt - velocity) / (0.5 * (dt + time))
        assert np.all(change <= LIMITS.acceleration * (1 + MARGIN) + 5e-3)
        velocity, time = step / dt, dt


@st.composite
def plans(draw: st.DrawFn) -> MotionSequence:
    """Motions that the plan's own check may or may not pass."""
    rate = draw(st.sampled_from([100.0, 125.0, 200.0, 500.0]))
    amplitude = draw(st.floats(0.01, 1.5))
    if draw(st.booleans()):
        sine, cosine = (
            np.array([[amplitude * draw(st.floats(-1, 1))], [0.5 * amplitude * draw(st.floats(-1, 1))]])
            for _ in range(2)
        )
        motion = RestToRest(FourierSeries(draw(st.floats(0.5, 3.0)), np.zeros(2), sine, cosine), 1, 0.5)
    else:
        points = np.array([[0.0, 0.0], [amplitude, -0.5 * amplitude], [0.1, 0.0]])
        motion = PointToPoint(points, np.array([draw(st.floats(0.05, 2.0)), draw(st.floats(0.05, 2.0))]))
    start = motion.evaluate(np.zeros(1))[0][:, 0]
    return MotionSequence([slow_move(np.zeros(2), start, JOINTS), motion], rate)


@settings(max_examples=20)
@given(
    path=plans(),
    stalls=st.lists(st.tuples(st.floats(0.0, 3.0), st.floats(0.0, 0.12)), max_size=4),
    take=st.floats(0.0, 0.01),
)
def test_plans_stalls_and_rates_never_pass_a_limit_at_the_arm(
    path: MotionSequence, stalls: list[tuple[float, float]], take: float
) -> None:
    """Player and gate together; the arm takes a while for each command, and the computer stalls."""
    period = 1.0 / path.rate
    with simulated_time() as clock:
        sent: list[np.ndarray] = []
        times: list[float] = []

        def receive(position: np.ndarray, _due: float) -> None:
            sent.append(position)
            times.append(clock.now())
            gate.measured(clock.now(), position)
            clock.sleep(take * period / 0.002 / 10)

        gate = CommandGate(receive, lambda *_: None, LIMITS, period, clock)
        gate.measured(clock.now(), np.zeros(2))
        player = Player(gate.command, path, LIMITS.acceleration, clock)

        def follow() -> None:
            while not player.done and player.failure is None:
                clock.sleep(0.01)
                gate.measured(clock.now(), sent[-1] if sent else np.zeros(2))

        begun = clock.now()
        for when, length in stalls:
            clock.call_at(begun + when, lambda length=length: clock.stall(length))
        player.start()
        follow()
        player.stop(1.0)
        clock.sleep(3.2)  # stalls that came too late
    try:
        for motion, where in zip(path._motions, ("approach", "motion"), strict=True):
            check_limits(motion, JOINTS, where)
        planned_well = True
    except UsageError:
        planned_well = False
    positions = np.array(sent).reshape(-1, 2)
    assert np.all(np.abs(positions) <= LIMITS.highest + 1e-9)
    if player.failure is not None:
        assert isinstance(player.failure, SafetyStopError)
        assert not planned_well or any(length > 0.02 for _, length in stalls), player.failure
    else:
        np.testing.assert_allclose(positions[-1], path.positions(np.array([path.duration]))[0], atol=1e-12)
        assert planned_well or np.max(np.abs(np.diff(positions, axis=0)) / period) <= 2.02 * 4
