"""The program that ur_rtde 1.6.5 uploads (`rtde_control.script`), as far as it is simulated, and the port it comes by.

Command n arrives in input_int_register_0. Realtime commands are obeyed every period; another command is obeyed once,
output_int_register_0 becomes 2 when it is done, and 1 again after command 0. Register 0 stays 1 while a blocking
command runs, as the script leaves it; the script reads no other command until then.

Of ur_rtde's program on the script port (30003) only its name and its register offset are read; another one runs as far
as `urscript` knows its words. The real port also sends the controller's state; this one is silent, as no client
listens.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.errors import ConnectionLostError, UsageError
from sim_drivers.rtde.controller import Controller
from sim_drivers.rtde.joint_motion import ACCELERATION_RANGE, JointMotion, MoveJ, VelocityRamp
from sim_drivers.rtde.session import Session
from sim_drivers.rtde.urscript import UrscriptProgram
from sim_drivers.rtde.variables import JOINTS, Value

READY, DONE = 1, 2
NO_COMMAND, MOVEJ, SPEEDJ, SERVOJ, SPEED_STOP, SERVO_STOP, SET_PAYLOAD = 0, 1, 9, 11, 15, 16, 17
STEP_TIME, TRIGGER_PROTECTIVE_STOP, STOPL, STOPJ, SET_WATCHDOG = 26, 31, 33, 34, 35
JOINTS_WITHIN_LIMITS, JOINT_TORQUES, IS_STEADY, STOP_SCRIPT = 37, 38, 47, 255

REALTIME = frozenset((6, 9, 10, 11, 24, 25, 26, 27, 38, 58, 66, 67, 68, 69, 70, 71))
"""Commands that the script obeys every period, simulated or not."""

PROGRESS_STARTED, PROGRESS_FINISHED = 0, -1
CONTROL_PROGRAM = "rtde_control"
LONGEST_SCRIPT = 250_000
_HEADER = re.compile(r"^(?:def|sec)\s+(\w+)\s*\(\s*\)\s*:", re.MULTILINE)
_END = re.compile(r"^end[ \t\r]*\n", re.MULTILINE)
_OFFSET = re.compile(r"reg_offset_int\s*=[^\n]*\n\s*(\d+)")


class ControlScript:
    """One run of the program; its registers begin at 24 for ur_rtde's FLAG_UPPER_RANGE_REGISTERS, else at 0."""

    def __init__(self, register_offset: int) -> None:
        self._offset = register_offset
        self._executing = False
        self._blocking: JointMotion | None = None
        self._asynchronous: JointMotion | None = None
        self._writes = self._operation = 0
        self._watchdog = 0.0
        self._kicked_at = 0.0

    def begin(self, controller: Controller) -> None:
        """Start of the program."""
        self._progress(controller, PROGRESS_FINISHED)
        self._signal(controller, READY)

    def kick(self, controller: Controller, received: Mapping[str, Value]) -> None:
        """Feed the watchdog with a client's writes."""
        if f"input_int_register_{self._offset}" in received:
            self._kicked_at = controller.arm.time

    def step(self, controller: Controller) -> None:
        """One period of the program's main loop."""
        if self._watchdog and controller.arm.time - self._kicked_at > 1.0 / self._watchdog:
            controller.fail_program(f"watchdog: fewer than {self._watchdog:g} commands per second")
            return
        if self._asynchronous is not None and self._asynchronous.finished:
            self._end_asynchronous(controller)
        if self._blocking is not None:
            if self._blocking.finished:
                self._blocking = None
                self._signal(controller, DONE)
            return
        command = self._integer(controller, 0)
        if command == NO_COMMAND:
            self._executing = False
            self._signal(controller, READY)
        elif command in REALTIME:
            if self._obey(controller, command):
                self._signal(controller, READY)
        elif not self._executing:
            self._executing = True
            if self._obey(controller, command) and self._blocking is None:
                self._signal(controller, DONE)

    def _obey(self, controller: Controller, command: int) -> bool:
        """Run a command; False where it ended the program."""
        action = _ACTIONS.get(command)
        if action is None:
            controller.fail_program(f"command {command} of ur_rtde is not simulated")
        else:
            action(self, controller)
        return controller.script is self

    def _move(self, controller: Controller) -> None:
        target = self._vector(controller, 0, JOINTS)
        speed, acceleration = self._vector(controller, 6, 2)
        if not controller.allowed(target):
            controller.protective_stop("the target of movej lies outside the joint limits")
            return
        if not (math.isfinite(speed) and math.isfinite(acceleration)):
            controller.fail_program("movej with a speed or an acceleration that is not a number")
            return
        self._end_asynchronous(controller)
        speed *= float(controller.values["target_speed_fraction"])  # type: ignore[arg-type]
        motion = MoveJ(controller.reference, target, speed, acceleration, controller.speed_limit)
        controller.motion = motion
        self._run(controller, motion)

    def _servo(self, controller: Controller) -> None:
        target = self._vector(controller, 0, JOINTS)
        lookahead = float(self._vector(controller, 9, 1)[0])
        controller.servo(target, lookahead)

    def _speed(self, controller: Controller) -> None:
        velocity = self._vector(controller, 0, JOINTS)
        acceleration = float(self._vector(controller, 6, 1)[0])
        if not (np.all(np.isfinite(velocity)) and math.isfinite(acceleration)):
            controller.fail_program("speedj with a speed or an acceleration that is not a number")
            return
        if not isinstance(controller.motion, VelocityRamp):
            controller.motion = VelocityRamp(controller.reference, velocity, acceleration)
        controller.motion.retarget(velocity, acceleration)

    def _stop(self, controller: Controller) -> None:
        """speed_stop and servo_stop; stopl's deceleration of the tool is applied to the leading joint."""
        self._end_asynchronous(controller)
        self._blocking = controller.brake(self._deceleration(controller))

    def _stop_move(self, controller: Controller) -> None:
        """Stopj and stopl, which can be asynchronous."""
        self._end_asynchronous(controller)
        self._run(controller, controller.brake(self._deceleration(controller)))

    def _deceleration(self, controller: Controller) -> float:
        deceleration = float(self._vector(controller, 0, 1)[0])
        return deceleration if math.isfinite(deceleration) else ACCELERATION_RANGE[1]

    def _run(self, controller: Controller, motion: JointMotion) -> None:
        if self._integer(controller, 1) == 1:
            self._asynchronous = motion
            self._progress(controller, PROGRESS_STARTED)
        else:
            self._blocking = motion

    def _end_asynchronous(self, controller: Controller) -> None:
        if self._asynchronous is not None:
            self._asynchronous = None
            self._progress(controller, PROGRESS_FINISHED)

    def _payload(self, controller: Controller) -> None:
        mass, *center = self._vector(controller, 0, 4).tolist()
        controller.values |= {"payload": mass, "payload_cog": tuple(center)}

    def _set_watchdog(self, controller: Controller) -> None:
        frequency = float(self._vector(controller, 0, 1)[0])
        self._watchdog = frequency if math.isfinite(frequency) and frequency > 0 else 0.0
        self._kicked_at = controller.arm.time

    def _joints_within_limits(self, controller: Controller) -> None:
        self._answer_integer(controller, int(controller.allowed(self._vector(controller, 0, JOINTS))))

    def _joint_torques(self, controller: Controller) -> None:
        """get_joint_torques: the measured torque less that of the arm's model."""
        measured = controller.measured
        self._answer_vector(controller, (measured.torque - measured.target_torque).tolist())

    def _integer(self, controller: Controller, register: int) -> int:
        return int(controller.values[f"input_int_register_{self._offset + register}"])  # type: ignore[arg-type]

    def _vector(self, controller: Controller, first: int, count: int) -> FloatArray:
        registers = range(self._offset + first, self._offset + first + count)
        return np.array([controller.values[f"input_double_register_{register}"] for register in registers])

    def _signal(self, controller: Controller, state: int) -> None:
        controller.values[f"output_int_register_{self._offset}"] = state

    def _answer_integer(self, controller: Controller, value: int) -> None:
        controller.values[f"output_int_register_{self._offset + 1}"] = value

    def _answer_vector(self, controller: Controller, values: list[float]) -> None:
        for register, value in enumerate(values):
            controller.values[f"output_double_register_{self._offset + register}"] = value

    def _progress(self, controller: Controller, progress: int) -> None:
        """Register 2: bits 24-30 number the operation, 16-22 the writes, 15 is set while running, below is progress."""
        self._writes = (self._writes + 1) % 128
        if progress == PROGRESS_STARTED:
            self._operation = (self._operation + 1) % 128
        value = self._writes << 16 | self._operation << 24
        if progress >= 0:
            value |= 1 << 15 | progress
        controller.values[f"output_int_register_{self._offset + 2}"] = value


_ACTIONS: Mapping[int, Callable[[ControlScript, Controller], None]] = {
    MOVEJ: ControlScript._move,
    SPEEDJ: ControlScript._speed,
    SERVOJ: ControlScript._servo,
    SPEED_STOP: ControlScript._stop,
    SERVO_STOP: ControlScript._stop,
    SET_PAYLOAD: ControlScript._payload,
    STEP_TIME: lambda script, controller: script._answer_vector(controller, [controller.period]),
    TRIGGER_PROTECTIVE_STOP: lambda _, controller: controller.protective_stop("asked for by the program"),
    STOPL: ControlScript._stop_move,
    STOPJ: ControlScript._stop_move,
    SET_WATCHDOG: ControlScript._set_watchdog,
    JOINTS_WITHIN_LIMITS: ControlScript._joints_within_limits,
    JOINT_TORQUES: ControlScript._joint_torques,
    IS_STEADY: lambda script, controller: script._answer_integer(controller, int(controller.steady)),
    STOP_SCRIPT: lambda _, controller: controller.stop_program(),
}


class ScriptSession(Session):
    """One client of the script port; a program continues when its client disconnects."""

    _pending = ""

    def receive(self, chunk: bytes) -> bytes:
        """Start every program that is complete with this chunk."""
        self._pending += chunk.decode("utf-8", errors="replace")
        while (end := _END.search(self._pending)) is not None:
            body, self._pending = self._pending[: end.start()], self._pending[end.end() :]
            header = _HEADER.search(body)
            if header is not None:
                self._start(header[1], body)
        if len(self._pending) > LONGEST_SCRIPT:
            raise ConnectionLostError("a script does not end")
        return b""

    def _start(self, name: str, body: str) -> None:
        if not self._controller.remote_control:
            self._controller.messages.append(
                f"the program '{name}' was not run: the controller is not in remote control"
            )
            return
        if name != CONTROL_PROGRAM:
            try:
                self._controller.start_program(UrscriptProgram(f"{body}end\n"))
            except UsageError as error:
                self._controller.messages.append(f"the program '{name}' was not run: {error.message}")
            return
        offset = _OFFSET.search(body)
        self._controller.start_program(ControlScript(24 if offset is not None and offset[1] == "24" else 0))
