"""Moving CAN motors: limits and time-outs in the motors, goals, and how they are stopped."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from drivers.can_motors.bus import PATIENCE, Feedback, MotorBus, MotorState
from drivers.can_motors.codec import CanFrame, MotorCodec
from drivers.can_motors.settings import CanMotor, CanMotorSettings
from drivers.core.arrays import FloatArray
from drivers.core.clock import Clock
from drivers.core.errors import ConnectionFailedError, ConnectionLostError, DriverStateError
from drivers.polled_arm import HOLD_LEAD, STOP_LIMIT, STOP_SENDINGS, not_at_rest
from drivers.standstill import StandstillWatch

OLD_TORQUE = 0.1
"""[s] after which a torque is not sent again: who commanded it does so no more."""
ENABLING = 0.5
"""How long [s] motors may take until they obey."""


class MotorControl:
    """Commands of the motors of a connection; one thread at a time.

    Whatever exchanges frames raises ConnectionLostError where the adapter is gone.

    Attributes:
        active: whether the motors were made to obey, and not yet stopped.
        obeying: whether all showed that they do.
        led: whether the arm is released, to be led by hand.
        goal: (n,) joint position that was commanded last [rad]; None before.
        commanded: when that was [s, host's monotonic clock].
        sent: goals when they were sent, since they were taken: (when [s, host's monotonic clock], (n,) [rad]).
        fresh: called with each new goal, so that it is sent at once.
    """

    def __init__(self, bus: MotorBus, settings: CanMotorSettings, clock: Clock) -> None:
        self._bus, self._settings, self._clock = bus, settings, clock
        self._motors = settings.motors
        self.active = self.obeying = self.led = False
        self.goal: FloatArray | None = None
        self.commanded = -np.inf
        self.sent: deque[tuple[float, FloatArray]] = deque()
        self.fresh: Callable[[], None] = _nothing
        self._pushed: tuple[float, FloatArray] | None = None
        self._led: list[MotorCodec] = []
        self._held = False

    def take(self) -> None:
        """Write limits and time-outs, read them back, and let the motors hold where they are.

        Raises:
            DriverStateError: a motor is in fault, or does not obey.
            ConnectionFailedError: a motor does not answer, or does not keep what is written.
        """
        self._prepare(self._bus.codecs)
        states = self._all_states().states
        goals = [m.to_joint("position", _holding_goal(m, states[k])) for k, m in enumerate(self._motors)]
        self.goal = np.array(goals)
        self.active = True  # from here on it may be that some obey
        self._make_obey()

    def release(self, torque: FloatArray | None) -> None:
        """Write limits and time-outs, read them back, and let the motors give torques, or none; raises as `take`."""
        watchdog = self._settings.keys.watchdog
        # A torque must end with this computer, whatever the arm does where goals fail to come.
        self._led = [type(codec)(replace(codec.motor, watchdog=watchdog)) for codec in self._bus.codecs]
        self._prepare(self._led)
        self.goal = self._positions(self._all_states())
        self._pushed = None if torque is None else (self._clock.now(), torque)
        self.active = self.led = True
        if self._bus.codecs[0].takes_torque:
            self._make_obey()

    def push(self, torque: FloatArray) -> None:
        """Take joint torques (n,) [N·m] of a released arm, which the next cycle sends.

        Raises:
            DriverStateError: it is not released.
        """
        if not self.led:
            raise DriverStateError("the arm is not released: it accepts no torque commands")
        self._pushed = self._clock.now(), torque.copy()

    def _prepare(self, codecs: Sequence[MotorCodec]) -> None:
        """What the motors' registers are to hold, written and read back."""
        for index, (motor, codec) in enumerate(zip(self._motors, codecs, strict=True)):
            state = self._bus.state(index)
            if state.fault:
                words = ", ".join(motor.address.family.fault_words(state.fault))
                raise DriverStateError(
                    f"{motor.name} is in fault: {words}",
                    hint="let it cool down, check its supply and load; then dynid check --connect --reset-faults",
                )
            if state.enabled:  # held by a program before: a time-out would count from that one's last command
                self._bus.send(codec.goal(_holding_goal(motor, state)))
            for register, value in codec.preparation().items():
                self._bus.write(index, register, value)

    def _make_obey(self) -> None:
        """Switch the motors on, and see that they obey."""
        for codec in self._bus.codecs:
            self._bus.send(codec.enable())
        end = self._clock.now() + ENABLING
        while True:
            states = self.cycle().states
            lazy = [m.name for k, m in enumerate(self._motors) if k not in states or states[k].enabled is False]
            if not lazy:
                break
            if self._clock.now() > end:
                raise DriverStateError(
                    f"{', '.join(lazy)} did not begin to obey within {ENABLING:g} s",
                    hint="check its power, its calibration, and what the manufacturer's tool reports",
                )
            self._clock.sleep(ENABLING / 25.0)
        self._bus.forget_surplus()
        self.obeying = True

    def command(self, target: FloatArray) -> None:
        """Take a goal (n,) [rad], which the next cycle sends at once.

        Raises:
            DriverStateError: a position beyond full scale of its motor's frames.
        """
        for motor, position in zip(self._motors, target.tolist(), strict=True):
            most = motor.address.model.position
            if most is not None and abs(motor.goal(position)) > most:
                there = motor.goal(position)
                raise DriverStateError(
                    f"{position:.4g} rad are {there:.4g} rad of {motor.name}: its frames end at {most:g}",
                    hint="check its zero, direction and ratio",
                )
        self.goal, self.commanded = target.copy(), self._clock.now()
        self.fresh()

    def cycle(self, patience: float = PATIENCE) -> Feedback:
        """Send the goal, and read the motors as they are before they obey it, waiting so long [s] at most."""
        if self.led:
            feedback = self._bus.cycle(self._torque_frames(), patience)
            if len(feedback.states) == len(self._motors):
                self.goal = self._positions(feedback)
            return replace(feedback, ages={})
        goal = self.goal
        assert goal is not None
        feedback = self._bus.cycle(self._goal_frames(goal), patience)
        self.sent.append((feedback.time, goal))
        return feedback

    def stop(self) -> str:
        """Let the arm hold or go limp, as the connection says; what is wrong, in words, or nothing."""
        led, self.active, self.obeying, self.led = self.led, False, False, False
        limp = self._settings.keys.on_stop == "limp"
        self._held = self._held or not limp
        try:
            if led and not limp:
                self._bus.send([frame for codec in self._bus.codecs for frame in codec.enable()])
            if not limp:
                self._lead_little(self._bus.cycle(None if self.goal is None else self._goal_frames(self.goal)))
            rest, heard = self._until_rest(limp=limp)
            if not limp and self._settings.when_lost == "hold":
                self._hold_for_good()
        except (ConnectionFailedError, ConnectionLostError) as error:
            return f"the command to stop could not be sent to the motors ({error.message}): {self.left_alone()}"
        if limp and (driving := [m.name for k, m in enumerate(self._motors) if k in heard and heard[k].enabled]):
            return f"{', '.join(driving)} still drives after it was switched off {STOP_SENDINGS} times: cut its power"
        if rest:
            return ""
        return not_at_rest([motor.name for k, motor in enumerate(self._motors) if k not in heard], limp=limp)

    def part(self) -> None:
        """Switch off an arm that goes limp with this program anyway: a time-out would leave its motors in fault."""
        held, self._held = self._held, False
        if held and self._settings.when_lost == "limp":
            with suppress(ConnectionLostError):
                for _ in range(STOP_SENDINGS):
                    self._bus.send([frame for codec in self._bus.codecs for frame in codec.disable()])

    def left_alone(self) -> str:
        """Return what the motors do when commands cease, in words."""
        if self._settings.when_lost == "hold":
            return "each holds its last goal with torque on"
        if self._settings.family == "moteus":
            return f"{self._settings.keys.watchdog:g} s later each does what its servo.timeout_mode says"
        return f"{self._settings.keys.watchdog:g} s later each goes limp by its time-out"

    def _until_rest(self, *, limp: bool) -> tuple[bool, dict[int, MotorState]]:
        """Command the stop until the arm is at rest, or `STOP_LIMIT` is over: whether it is, and what motors said."""
        watch, end = StandstillWatch(0.2), self._clock.now() + STOP_LIMIT
        heard: dict[int, MotorState] = {}
        sendings = 0
        while not watch.at_rest:
            if self._clock.now() >= end:
                return False, heard
            begun = self._clock.now()
            if limp:
                if sendings < STOP_SENDINGS:
                    self._bus.send([frame for codec in self._bus.codecs for frame in codec.disable()])
                    sendings += 1
                feedback = self._bus.exchange(
                    [frame for codec in self._bus.codecs for frame in _asked_while_limp(codec)],
                    1.0 / self._settings.keys.rate,
                )
            else:
                feedback = self.cycle()
            heard |= feedback.states
            if len(feedback.states) == len(self._motors):
                watch.add(feedback.time, self._positions(feedback))
            self._clock.sleep_until(begun + 1.0 / self._settings.keys.rate)
        return True, heard

    def _lead_little(self, feedback: Feedback) -> None:
        """Goals near where the joints are, of the motors that answer."""
        if self.goal is None:
            return
        goal = self.goal.copy()
        for index, state in feedback.states.items():
            here = self._motors[index].to_joint("position", state.values["position"])
            goal[index] = here + np.clip(goal[index] - here, -HOLD_LEAD, HOLD_LEAD)
        self.goal = goal

    def _hold_for_good(self) -> None:
        """No time-out: it would take the end of this program for its death."""
        goals = self._motor_goals(self.goal).tolist() if self.goal is not None else None
        for index, codec in enumerate(self._bus.codecs):
            for register, value in codec.release().items():
                self._bus.write(index, register, value)
            if goals is not None:
                for _ in range(STOP_SENDINGS):
                    self._bus.send(codec.release_frames(goals[index]))

    def _all_states(self) -> Feedback:
        """A reading of all motors."""
        for _ in range(STOP_SENDINGS):
            feedback = self._bus.cycle()
            if len(feedback.states) == len(self._motors):
                return feedback
        silent = [motor.name for index, motor in enumerate(self._motors) if index not in feedback.states]
        raise ConnectionFailedError(f"{', '.join(silent)} did not answer", where=self._settings.where)

    def _positions(self, feedback: Feedback) -> FloatArray:
        return np.array(
            [m.to_joint("position", feedback.states[k].values["position"]) for k, m in enumerate(self._motors)]
        )

    def _goal_frames(self, goal: FloatArray) -> list[Sequence[CanFrame]]:
        """Frames that let every motor go to a goal (n,) [rad]."""
        goals = self._motor_goals(goal).tolist()
        return [codec.goal(position) for codec, position in zip(self._bus.codecs, goals, strict=True)]

    def _torque_frames(self) -> list[Sequence[CanFrame]]:
        """Frames by which every motor gives the torque that was commanded last, or none where that is old."""
        pushed = self._pushed
        if pushed is None or self._clock.now() - pushed[0] > OLD_TORQUE:
            return [codec.released() for codec in self._led]
        sides = zip(self._led, self._motors, pushed[1].tolist(), strict=True)
        return [codec.torque(motor.direction * torque / motor.ratio) for codec, motor, torque in sides]

    def _motor_goals(self, goal: FloatArray) -> FloatArray:
        return np.array([motor.goal(float(position)) for motor, position in zip(self._motors, goal, strict=True)])


def _holding_goal(motor: CanMotor, state: MotorState) -> float:
    """The motor's goal [rad] by which it goes on as it is: a spring that bears a weight is aimed beyond where it is."""
    position, stiffness = state.values["position"], motor.address.kp
    if state.enabled is False or stiffness <= 0.0:
        return position
    most = HOLD_LEAD * motor.ratio
    return position + min(max(state.values["torque"] / stiffness, -most), most)


def _asked_while_limp(codec: MotorCodec) -> Sequence[CanFrame]:
    """Frames that switch a motor off, and after which it tells where it is, and whether it drives."""
    requests = () if codec.answers_goals else (*codec.poll(read_only=False), *codec.slow_poll())
    return (*codec.disable(), *requests)


def _nothing() -> None:
    """No cycle waits for goals yet."""
