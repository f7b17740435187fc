"""A simulated Universal Robots controller without its sockets: registers, the control script, motion, safety.

What a program of ur_rtde does on a controller is written in its `rtde_control.script`; here the same commands, read
from the same registers, move the plant. A command that is not simulated ends the program, as an error in a script
does, and so ur_rtde reports failure instead of success.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np

from daq.robot.schema import JointLimits
from drivers.core.arrays import FloatArray
from drivers.core.errors import UsageError
from sim_drivers.plant.control import Reference
from sim_drivers.plant.plant import Plant
from sim_drivers.plant.sensors import Measurement
from sim_drivers.rtde.joint_motion import JointMotion, ServoJ, VelocityRamp
from sim_drivers.rtde.variables import JOINTS, SIZES, ControllerVersion, Value, input_variables, output_variables, zero

STOPPED, PLAYING = 1, 2
"""runtime_state."""
NORMAL, PROTECTIVE_STOP = 1, 3
"""safety_mode."""
SUPPLY_VOLTAGE = 48.0
"""[V], of the joints."""
TOOL_IDLE = 255
"""tool_mode."""
_UNKNOWN = (
    "actual_TCP_pose actual_TCP_speed actual_TCP_force actual_TCP_acceleration target_TCP_pose target_TCP_speed "
    "target_TCP_acceleration tcp_force_scalar elbow_position elbow_velocity actual_tool_accelerometer "
    "tool_temperature actual_momentum ft_raw_wrench wrench_calc_from_currents actual_current_as_torque "
    "actual_current_window target_gravity target_base_wrench"
)
"""The plant has no Cartesian motion, tool or force sensor: not a number, rather than a number that was not measured."""
ROBOT_MODE_RUNNING = 7
JOINT_MODE_RUNNING = 253

PROGRAM_END_DECELERATION = 4.0
PROTECTIVE_STOP_DECELERATION = 20.0
"""[rad/s²]: assumptions; the manufacturer publishes stopping times and distances only."""
DRIFT_ACCELERATION = 4.0
"""Acceleration of a drift on request [rad/s²]."""
UNLOCK_DELAY = 5.0
"""A protective stop can be unlocked only so long [s] after it happened."""
STEADY_TIME = 0.1
"""Rest of this duration [s] counts as steady."""


class ControlProgram(Protocol):
    """A program that runs on the controller."""

    def begin(self, controller: Controller) -> None:
        """Start of the program."""

    def kick(self, controller: Controller, received: Mapping[str, Value]) -> None:
        """Feed the watchdog with a client's writes."""

    def step(self, controller: Controller) -> None:
        """One period."""


ACCELERATION_LIMIT = 40.0
"""Acceleration limit of a joint [rad/s²], where no robot file says it: an assumption."""


class Controller:
    """Everything of a controller that is not a socket.

    Args:
        arm: the plant, six joints.
        version: of the controller's software.
        period: of its loop [s].
        joints: limits of the joints; ±2π and π rad/s where None, as on every UR.

    Attributes:
        lengths: upper arm, forearm, shoulder offset, wrist offset [m], as its configuration tells; 0 for unknown.
        remote_control: whether programs and stops from outside are obeyed.

    Raises:
        UsageError: the arm has not six joints.
    """

    def __init__(
        self, arm: Plant, version: ControllerVersion, period: float, joints: Sequence[JointLimits] | None = None
    ) -> None:
        measured = arm.measure()
        count = len(measured.position)
        if count != JOINTS:
            raise UsageError(
                f"RTDE is for arms of {JOINTS} joints, not {count}", hint="simulate it on another bus: --wire canopen"
            )
        self.arm = arm
        self.version = version
        self.period = period
        limits = [joint.position for joint in joints] if joints else [(-2 * math.pi, 2 * math.pi)] * count
        self.lower, self.upper = np.array(limits, dtype=np.float64).T
        self.speed_limit = np.array([joint.velocity or math.inf for joint in joints] if joints else [math.pi] * count)
        accelerations = [joint.acceleration for joint in joints] if joints else [ACCELERATION_LIMIT] * count
        self.acceleration_limit = np.array(accelerations)
        self.lengths = [0.0] * 4
        self.remote_control = True
        variables = input_variables(version) | output_variables(version)
        self.values: dict[str, Value] = {name: zero(kind) for name, kind in variables.items()}
        self.reference = Reference.at_rest(np.asarray(measured.target_position, dtype=np.float64))
        self.motion: JointMotion | None = None
        self.script: ControlProgram | None = None
        self.safety_mode = NORMAL
        self.refused: set[str] = set()
        self.clock_ahead = 0.0
        self.messages: deque[str] = deque(maxlen=100)
        self._stopped_at = -math.inf
        self._stop_drift()
        self._still_since = arm.time
        self._steps, self._energy = 0, 0.0
        self._set_constants()
        self._publish(measured)

    @property
    def steady(self) -> bool:
        """Return whether the arm is steady."""
        return self.arm.time - self._still_since >= STEADY_TIME

    def step(self) -> None:
        """One period: obey, move, advance time, measure."""
        if self.script is not None:
            self.script.step(self)
        if self.safety_mode == NORMAL:
            if self.motion is not None:
                self.follow(self.motion.step(self.period))
                if self.motion is not None and self.motion.finished:
                    self.motion = None
            reference = self._drifted()
            if self.safety_mode == NORMAL:
                self.arm.set_target(reference.position, reference.velocity, reference.acceleration)
        self.arm.advance(self.period)
        self._publish(self.arm.measure())
        self._steps += 1
        self._energy += SUPPLY_VOLTAGE * float(self.values["actual_robot_current"]) * self.period  # type: ignore[arg-type]
        self.values |= {"control_step": self._steps, "actual_robot_energy_consumed": self._energy}

    def follow(self, reference: Reference) -> None:
        """Apply a reference, or stop protectively where it lies outside the limits."""
        if not self.allowed(reference.position, reference.velocity):
            self.protective_stop("a joint left its limits of position or speed")
            return
        self.reference = reference
        if np.any(reference.velocity):
            self._still_since = self.arm.time

    def allowed(self, position: FloatArray, velocity: FloatArray | None = None) -> bool:
        """Return whether positions (n,), and speeds, are numbers within the joint limits."""
        inside = bool(np.all((position >= self.lower - 1e-9) & (position <= self.upper + 1e-9)))
        if velocity is None or not inside:
            return inside
        return bool(np.all(np.abs(velocity) <= self.speed_limit * (1.0 + 1e-9)))

    def servo(self, target: FloatArray, lookahead: float) -> None:
        """Servoj's target (6,) [rad], followed with so many seconds of lookahead; outside the limits a stop."""
        if not self.allowed(target) or math.isnan(lookahead):
            self.protective_stop("the target of servoj lies outside the joint limits")
            return
        if not isinstance(self.motion, ServoJ):
            self.motion = ServoJ(self.reference)
        self.motion.retarget(target, lookahead)

    def brake(self, deceleration: float) -> JointMotion:
        """Begin to stop; the leading joint decelerates so fast [rad/s²]."""
        self.motion = VelocityRamp(self.reference, np.zeros(JOINTS), deceleration)
        return self.motion

    def start_program(self, program: ControlProgram) -> None:
        """Start a program; refused while stopped protectively."""
        if self.safety_mode != NORMAL:
            self.messages.append("a program was refused: protective stop")
            return
        self.stop_program()
        self.script = program
        self.script.begin(self)

    def stop_program(self) -> None:
        """End the program; a moving arm decelerates."""
        if self.script is None:
            return
        self.script = None
        if self.safety_mode == NORMAL:
            before = self.reference
            self.reference = Reference(
                before.position + self._drift_offset, before.velocity + self._drift_velocity, before.acceleration
            )
            self._stop_drift()
            self.brake(PROGRAM_END_DECELERATION)

    def fail_program(self, reason: str) -> None:
        """End the program as an error in a script does."""
        self.messages.append(reason)
        self.stop_program()

    def protective_stop(self, reason: str) -> None:
        """Brake hard and end the program."""
        if self.safety_mode == PROTECTIVE_STOP:
            return
        self.messages.append(f"protective stop: {reason}")
        self.safety_mode = PROTECTIVE_STOP
        self._stopped_at = self.arm.time
        self.motion = None
        self.script = None
        self._stop_drift()
        self.arm.halt(PROTECTIVE_STOP_DECELERATION)

    def unlock_protective_stop(self) -> bool:
        """Release the arm; False where the stop is too recent."""
        if self.arm.time - self._stopped_at < UNLOCK_DELAY:
            return False
        if self.safety_mode == PROTECTIVE_STOP:
            self.safety_mode = NORMAL
            held = np.asarray(self.arm.measure().target_position, dtype=np.float64)
            self.reference = Reference.at_rest(np.clip(held, self.lower, self.upper))
        return True

    def drift(self, joint: int, velocity: float) -> None:
        """A fault: move a joint away from its reference at a velocity [rad/s], until the program ends."""
        if self.script is None:
            self.messages.append("no drift: no program is running")
            return
        self._drift_wanted[joint] = velocity

    def _stop_drift(self) -> None:
        self._drift_wanted, self._drift_velocity, self._drift_offset = np.zeros((3, JOINTS))

    def _drifted(self) -> Reference:
        """The reference with the drift, one period later."""
        if not np.any(self._drift_wanted) and not np.any(self._drift_offset):
            return self.reference
        step = DRIFT_ACCELERATION * self.period
        change = np.clip(self._drift_wanted - self._drift_velocity, -step, step)
        self._drift_velocity = self._drift_velocity + change
        self._drift_offset = self._drift_offset + self.period * (self._drift_velocity - 0.5 * change)
        reference = Reference(
            self.reference.position + self._drift_offset,
            self.reference.velocity + self._drift_velocity,
            self.reference.acceleration + change / self.period,
        )
        if not self.allowed(reference.position, reference.velocity):
            self.protective_stop("a joint drifted out of its limits of position or speed")
        return reference

    def write_inputs(self, received: dict[str, Value]) -> None:
        """Apply a client's data: registers, and outputs under their masks."""
        values = self.values
        values.update(received)
        if self.script is not None:
            self.script.kick(self, received)
        if received.get("speed_slider_mask"):
            fraction = float(values["speed_slider_fraction"])  # type: ignore[arg-type]
            values["target_speed_fraction"] = min(max(fraction, 0.0), 1.0) if math.isfinite(fraction) else 0.0
        bits = int(values["actual_digital_output_bits"])  # type: ignore[arg-type]
        for group, first in (("standard", 0), ("configurable", 8), ("tool", 16)):
            if f"{group}_digital_output_mask" in received:
                mask = int(values[f"{group}_digital_output_mask"])  # type: ignore[arg-type]
                level = int(values[f"{group}_digital_output"])  # type: ignore[arg-type]
                bits = bits & ~(mask << first) | (level & mask) << first
        values["actual_digital_output_bits"] = bits
        if "standard_analog_output_mask" in received:
            mask = int(values["standard_analog_output_mask"])  # type: ignore[arg-type]
            voltage = int(values["standard_analog_output_type"])  # type: ignore[arg-type]
            for channel in range(2):
                if mask >> channel & 1:
                    share = float(values[f"standard_analog_output_{channel}"])  # type: ignore[arg-type]
                    full = 10.0 * share if voltage >> channel & 1 else 0.004 + 0.016 * share
                    values[f"standard_analog_output{channel}"] = full

    def _set_constants(self) -> None:
        kinds = output_variables(self.version)
        for name in _UNKNOWN.split():
            if name in kinds:
                self.values[name] = (math.nan,) * SIZES[kinds[name]] if SIZES[kinds[name]] > 1 else math.nan
        self.values |= {
            "robot_mode": ROBOT_MODE_RUNNING,
            "joint_mode": (JOINT_MODE_RUNNING,) * JOINTS,
            "speed_scaling": 1.0,
            "target_speed_fraction": 1.0,
            "actual_main_voltage": SUPPLY_VOLTAGE,
            "actual_robot_voltage": SUPPLY_VOLTAGE,
            "actual_joint_voltage": (SUPPLY_VOLTAGE,) * JOINTS,
            "tool_mode": TOOL_IDLE,
        }

    def _publish(self, measured: Measurement) -> None:
        self.measured = measured
        stopped = self.safety_mode == PROTECTIVE_STOP
        playing = self.script is not None
        current = measured.current.tolist()
        self.values |= {
            "timestamp": self.arm.time + self.clock_ahead,
            "actual_q": measured.position.tolist(),
            "actual_qd": measured.velocity.tolist(),
            "actual_current": current,
            "joint_control_output": current,
            "actual_robot_current": sum(map(abs, current)),
            "joint_temperatures": measured.temperature.tolist(),
            "target_q": measured.target_position.tolist(),
            "target_qd": measured.target_velocity.tolist(),
            "target_qdd": measured.target_acceleration.tolist(),
            "target_current": measured.target_current.tolist(),
            "target_moment": measured.target_torque.tolist(),
            "safety_mode": self.safety_mode,
            "safety_status": self.safety_mode,
            # Bit 0: normal mode; bits 2 and 10: protective stop, stopped due to safety.
            "safety_status_bits": 0b100_0000_0100 if stopped else 1,
            # Bit 0: power on; bit 1: program running.
            "robot_status_bits": 0b11 if playing else 0b01,
            "runtime_state": PLAYING if playing else STOPPED,
        }
