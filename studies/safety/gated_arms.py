"""Simulated arms behind three buses, as the command gate sees them, in simulated time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np

from daq.robot.schema import JointLimits
from daq.session.command_gate import GateLimits
from drivers.can_signals.driver import Commander
from drivers.can_signals.settings import parse_settings
from drivers.canopen402.motion.target_path import BRIDGED, TargetPath
from drivers.canopen402.samples.sync import LATEST
from drivers.core.arrays import FloatArray
from drivers.core.errors import SafetyStopError
from sim_drivers.can_signals.arm import TableArm
from sim_drivers.canopen.motion import AxisReference, CyclicPosition, SyncClock
from sim_drivers.plant.control import Reference
from sim_drivers.plant.sensors import Measurement
from sim_drivers.rtde.joint_motion import ServoJ

JOINTS = (
    JointLimits(name="shoulder", position=(-3.0, 3.0), velocity=2.0, acceleration=8.0),
    JointLimits(name="elbow", position=(-2.0, 2.0), velocity=1.0, acceleration=5.0),
)
LIMITS = GateLimits.of_joints(JOINTS)
STEP, EVERY = 1e-3, 0.01
"""Periods of the arm's interpolation, and of the means that are its velocity and acceleration, of counts [s]."""
SETTLED = 0.3
"""How long [s] after a pause of the commands the arm's own reaction to it may last."""
COUNTS = 524288 / (2.0 * np.pi)
HEARTBEAT = 0.1
"""Default heartbeat of CiA 402 drives [s]."""
BUSES = ("RTDE", "CiA 402", "signal table")


class Arm(Protocol):
    """A simulated arm behind its bus."""

    def command(self, now: float, position: FloatArray) -> None: ...

    def advance(self, now: float) -> None:
        """Go on to `now` [s]."""

    @property
    def reference(self) -> FloatArray: ...

    @property
    def log(self) -> list[tuple[float, FloatArray]]: ...


class RtdeArm:
    """servoj: each period of the controller it takes the newest position."""

    def __init__(self, start: FloatArray, rate: float, begun: float) -> None:
        self._period, self._time = 1.0 / rate, begun
        self._servo = ServoJ(Reference.at_rest(start))
        self._target, self.reference = start, start
        self.log = [(begun, start)]

    def command(self, now: float, position: FloatArray) -> None:
        self._target = position

    def advance(self, now: float) -> None:
        while self._time + self._period <= now + 1e-9:
            self._time += self._period
            self._servo.retarget(self._target, 0.1)
            self.reference = self._servo.step(self._period).position
            self.log.append((self._time, self.reference))


class CiA402Arm:
    """Targets as the driver gives them at SYNC, cyclic set-points as the simulated drives interpolate them.

    A SYNC that this computer cannot send in time is sent late, or left out, as `SyncProducer` does. Where more are left
    out in a row than drives bridge, or commands have ceased, the drives stop along their ramp, as by `DriveMotion`.
    """

    def __init__(self, start: FloatArray, rate: float, begun: float, free: Callable[[float], float]) -> None:
        self._period, self._time, self._free = 1.0 / rate, begun, free
        self._clock = SyncClock(self._period)
        self._path = TargetPath(np.rint(start * COUNTS).astype(int).tolist(), self._period)
        self._syncs, self._begun, self._left_out = 0, begun, 0
        self._stops = False
        self._next = self._path.at(begun - self._period)
        self._axes = [CyclicPosition(AxisReference(float(position)), begun) for position in start]
        self.reference = start
        self.log = [(begun, start)]

    def command(self, now: float, position: FloatArray) -> None:
        if self._stops:
            raise SafetyStopError("the drives were stopped: SYNCs were left out, or commands have ceased")
        self._path.put(now, np.rint(position * COUNTS).astype(int).tolist())

    def advance(self, now: float) -> None:
        while self._time + STEP <= now + 1e-9 and not self._stops:
            self._time += STEP
            while (sent := self._free(moment := self._begun + self._syncs * self._period)) <= self._time + 1e-9:
                self._syncs += 1
                if sent - moment > LATEST * self._period:
                    self._left_out += 1
                    continue
                self._stops = self._stops or self._left_out > BRIDGED or self._path.run_out
                if self._left_out:
                    self._next = self._path.at(moment - self._period, self._left_out)
                    self._left_out = 0
                target, self._next = np.array(self._next) / COUNTS, self._path.at(moment)
                heard = self._clock.tick(sent)
                for axis, position in zip(self._axes, target.tolist(), strict=True):
                    axis.aim(position, heard, self._clock.cycle)
            self.reference = np.array([axis.step(STEP).position for axis in self._axes])
            self.log.append((self._time, self.reference))


class TablePlant:
    """Follows its target; what it was told to do, ms by ms."""

    def __init__(self, start: FloatArray, begun: float) -> None:
        self.time, self.position, self.log = begun, start, [(begun, start)]

    def set_target(
        self, position: FloatArray, velocity: FloatArray | None = None, acceleration: FloatArray | None = None
    ) -> None:
        self.position = position

    def halt(self, deceleration: float) -> None: ...

    def advance(self, duration: float) -> None:
        self.time += duration
        self.log.append((self.time, self.position))

    def heat(self, joint: int, celsius: float) -> None: ...

    def block(self, joint: int) -> None: ...

    def stick(self, joint: int, quantity: str) -> None: ...

    def measure(self) -> Measurement:
        zero = np.zeros(len(self.position))
        now, still = self.position, (zero, zero, zero)
        return Measurement(self.time, now, zero, *still, now, *still, lambda: zero)


class SignalTableArm:
    """Command frames of a signal table, and the simulated arm that follows them."""

    def __init__(self, start: FloatArray, rate: float, begun: float) -> None:
        position = {"quantity": "position", "length": 24, "signed": True, "scale": 2.0**-20, "unit": "rev"}
        names = [joint.name for joint in JOINTS]
        own = [{**position, "joint": name, "id": 0x181, "start": 24 * index} for index, name in enumerate(names)]
        told = [{**one, "id": 0x201} for one in own]
        for one in told:
            del one["quantity"]
        keys = {
            "interface": "virtual",
            "channel": "none",
            "bitrate": 1_000_000,
            "rate": rate,
            "signals": own,
            "start": [{"id": 0x200, "data": "01"}],
        }
        keys |= {"stop": [{"id": 0x200, "data": "00"}], "command": {"quantity": "position", "signals": told}}
        settings = parse_settings(keys, names)
        assert settings.command is not None
        self._commander = Commander(settings.command, names)
        self._plant = TablePlant(start, begun)
        self._arm = TableArm(self._plant, JOINTS, settings)  # type: ignore[arg-type]  # has what a table needs
        self._arm.obey(0x200, b"\1")
        self._begun, self._time = begun, begun

    @property
    def reference(self) -> FloatArray:
        return self._plant.position

    @property
    def log(self) -> list[tuple[float, FloatArray]]:
        return self._plant.log

    def command(self, now: float, position: FloatArray) -> None:
        self.advance(now)
        for identifier, data in self._commander.frames(position):
            self._arm.obey(identifier, data)

    def advance(self, now: float) -> None:
        if now > self._time:
            self._arm.advance(now - self._time)
            self._time = now


def new_arm(bus: str, start: FloatArray, rate: float, begun: float, free: Callable[[float], float]) -> Arm:
    if bus == "RTDE":
        return RtdeArm(start, rate, begun)
    return CiA402Arm(start, rate, begun, free) if bus == "CiA 402" else SignalTableArm(start, rate, begun)
