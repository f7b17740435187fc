"""One simulated motor of each family: what it hears, what it answers, when it lets go."""

from __future__ import annotations

import math
import struct
from abc import ABC, abstractmethod
from collections.abc import Mapping

from drivers.can.bus import EXTENDED, REMOTE
from drivers.can_motors import mit, moteus, odrive, robstride
from drivers.can_motors.codec import CanFrame, from_counts, to_counts
from drivers.can_motors.settings import CanMotor
from drivers.core.units import TURN
from sim_drivers.can_motors.arm import Command, MotorPlant
from sim_drivers.plant.clocked_arm import POWER_UP

MOVING = (moteus.GOAL, moteus.SPEED, moteus.STOP)
"""Registers in turns, or turns per second."""
SERIAL = 0x385F_3245_3130
"""Serial number of the first ODrive."""


class SimulatedMotor(ABC):
    """State of a motor; the plant behind it is the server's.

    Attributes:
        motor: as given.
        enabled: whether it drives.
        fault: its code; 0 without.
        dead: whether it neither answers nor drives.
        silent_until: until when its power comes up [s, host's clock].
    """

    over_temperature: int
    under_voltage: int
    timed_out: int
    position_byte = 1  # of an answer

    def __init__(self, motor: CanMotor, index: int, plant: MotorPlant) -> None:
        self.motor, self.index, self._plant = motor, index, plant
        self.enabled, self.fault, self.dead = False, 0, False
        self.silent_until = -math.inf
        self._commanded = -math.inf
        self._registers: dict[int, float] = {}

    @abstractmethod
    def hear(self, identifier: int, data: bytes, now: float) -> list[CanFrame]:
        """Obey a frame [s, host's clock], with `EXTENDED` and `REMOTE`; what it answers."""

    @property
    def timeout(self) -> float | None:
        """[s] without a command after which it lets go; None where it goes on."""
        return None

    def hold(self, position: float, now: float) -> None:
        """Drive, and hold the joint at a position [rad] with the gains of the truth."""
        self._enable(now)
        self._follow(now, self.motor.goal(position), None)

    def watch(self, now: float) -> None:
        """Let go where no command came for too long."""
        if self.enabled and self.timeout is not None and now - self._commanded > self.timeout:
            self.protect(self.timed_out)

    def protect(self, fault: int) -> None:
        """Go into a fault: it drives no more."""
        self.fault = fault
        self._let_go()

    def restart(self, now: float) -> None:
        """Interrupt its power: it is as at the start, and silent for a while."""
        self.silent_until = now + POWER_UP
        self.fault = 0
        self._registers.clear()
        self._let_go()

    def die(self) -> None:
        """A broken cable: it neither hears nor drives."""
        self.dead = True
        self._let_go()

    def of_other(self, identifier: int, data: bytes) -> bytes:
        """Return what another motor with the same id answers: it stands elsewhere."""
        del identifier
        place = self.position_byte
        return data[:place] + bytes([data[place] ^ 8]) + data[place + 1 :] if len(data) > place else data

    def _enable(self, now: float) -> None:
        if not self.fault:
            self.enabled, self._commanded = True, now

    def _let_go(self) -> None:
        self.enabled = False
        self._plant.let_go(self.index)

    def _follow(
        self,
        now: float,
        goal: float,
        gains: tuple[float, float] | None,
        speed: float = 0.0,
        stop: float = math.nan,
        torque: float = 0.0,
        shares: tuple[float, float] = (1.0, 1.0),
    ) -> None:
        """Obey a command: a goal that moves on at a speed until a stop, with a torque of its own; all of the motor.

        `gains` are kp and kd, of the truth where None; `shares` how much of them acts.
        """
        self._commanded = now
        if self.enabled:
            self._plant.command(self.index, now, Command(goal, speed, stop, torque), gains, shares)

    @property
    def _state(self) -> Mapping[str, float]:
        return self._plant.measured(self.index)

    def _byte(self, quantity: str) -> int:
        return min(max(round(self._state[quantity]), 0), 255)


class MitMotor(SimulatedMotor):
    """A motor in MIT mode."""

    def _obey(self, data: bytes, now: float) -> None:
        if data == mit.ENABLE:
            self._enable(now)
        elif data == mit.DISABLE:
            self._let_go()
        else:
            goal, speed, kp, kd, torque = mit.unpack_goal(self.motor.address.model, data)
            self._follow(now, goal, (kp, kd), torque=torque + kd * speed)


class DamiaoMotor(MitMotor):
    """A Damiao motor: commands on its id, requests on 0x7FF, answers on its master id."""

    over_temperature, under_voltage, timed_out = 12, 9, 13

    def hear(self, identifier: int, data: bytes, now: float) -> list[CanFrame]:  # noqa: D102
        address = self.motor.address
        if identifier == mit.DAMIAO_REQUEST and data[:2] == struct.pack("<H", address.id) and len(data) == 8:
            return self._asked(data)
        if identifier != address.id or len(data) != 8:
            return []
        if data == mit.CLEAR:
            self.fault = 0
        else:
            self._obey(data, now)
        return [self._told()]

    @property
    def timeout(self) -> float | None:  # noqa: D102
        counts = self._registers.get(mit.DamiaoCodec.registers["timeout"], 0)
        return counts * mit.TIMEOUT_COUNT or None

    def _asked(self, data: bytes) -> list[CanFrame]:
        address, code, number = self.motor.address, data[2], data[3]
        if code == mit.STATE:
            return [self._told()]
        if code not in (mit.READ, mit.WRITE):
            return []
        form = "<I" if number in mit.WHOLE_NUMBERS else "<f"
        if code == mit.WRITE:
            self._registers[number] = struct.unpack(form, data[4:])[0]
        p, v, t, _, _ = mit.full_scale(address.model)
        own = {1: 1.0, 7: address.host, 8: address.id, 9: 0, 10: mit.MIT_MODE, 21: p, 22: v, 23: t}
        return [(address.host, data[:4] + struct.pack(form, self._registers.get(number, own.get(number, 0))))]

    def _told(self) -> CanFrame:
        address, state = self.motor.address, self._state
        packed = mit.pack_state(address.model, state["position"], state["velocity"], state["torque"])
        code = self.fault or int(self.enabled)
        first = bytes([address.id & 0x0F | code << 4])
        return address.host, first + packed + bytes([self._byte("drive_temperature"), self._byte("temperature")])


class CubemarsMotor(MitMotor):
    """A CubeMars motor in MIT mode."""

    over_temperature, under_voltage, timed_out = 1, 4, 0

    def hear(self, identifier: int, data: bytes, now: float) -> list[CanFrame]:  # noqa: D102
        address = self.motor.address
        if identifier != address.id or len(data) != 8:
            return []
        self._obey(data, now)
        state = self._state
        packed = mit.pack_state(address.model, state["position"], state["velocity"], state["torque"])
        heat = min(max(round(state["temperature"] - address.temperature_offset), 0), 255)
        return [(address.host, bytes([address.id]) + packed + bytes([heat, self.fault]))]


class RobstrideMotor(SimulatedMotor):
    """A RobStride motor with its private protocol."""

    over_temperature, under_voltage, timed_out = 1 << 2, 1 << 0, 0

    def hear(self, identifier: int, data: bytes, now: float) -> list[CanFrame]:  # noqa: D102
        address = self.motor.address
        if not identifier & EXTENDED or identifier & 0xFF != address.id or len(data) != 8:
            return []
        kind, middle = identifier >> 24 & 0x1F, identifier >> 8 & 0xFFFF
        host = middle & 0xFF if kind != robstride.GOAL else address.host
        if kind == robstride.READ:
            return [self._parameter(struct.unpack_from("<H", data)[0], host)]
        if kind == robstride.WRITE:
            number = struct.unpack_from("<H", data)[0]
            self._registers[number] = struct.unpack_from(robstride.FORMATS.get(number, "<f"), data, 4)[0]
            if number == robstride.RobstrideCodec.registers["torque_limit"]:
                self._plant.limit(self.index, self._registers[number])
        elif kind == robstride.ENABLE:
            self._enable(now)
        elif kind == robstride.DISABLE:
            self.fault = 0 if data[0] == 1 else self.fault
            self._let_go()
        elif kind == robstride.GOAL:
            p, v, t, kp, kd = mit.full_scale(address.model)
            counts = struct.unpack(">4H", data)
            gains = from_counts(counts[2], 0.0, kp, 16), from_counts(counts[3], 0.0, kd, 16)
            torque = from_counts(middle, -t, t, 16) + gains[1] * from_counts(counts[1], -v, v, 16)
            self._follow(now, from_counts(counts[0], -p, p, 16), gains, torque=torque)
        else:
            return []
        return [self._told(host)]

    @property
    def timeout(self) -> float | None:  # noqa: D102
        counts = self._registers.get(robstride.RobstrideCodec.registers["timeout"], 0)
        return counts * mit.TIMEOUT_COUNT or None

    def protect(self, fault: int) -> None:
        """Its time-out is no fault: the motor is only switched off."""
        self.fault |= fault
        self._let_go()

    def of_other(self, identifier: int, data: bytes) -> bytes:
        """A parameter's value stands behind its number."""
        if identifier >> 24 & 0x1F != robstride.READ:
            return super().of_other(identifier, data)
        return data[:5] + bytes([data[5] ^ 8]) + data[6:]

    def _parameter(self, number: int, host: int) -> CanFrame:
        state = self._state
        own = {0x7019: state["position"], 0x701B: state["velocity"], 0x701A: state["torque"], 0x7005: 0, 0x7028: 0}
        value = self._registers.get(number, own.get(number, 0.0))
        packed = struct.pack(robstride.FORMATS.get(number, "<f"), value)
        identifier = robstride.frame_identifier(robstride.READ, self.motor.id, host)
        return identifier, struct.pack("<H2x", number) + packed

    def _told(self, host: int) -> CanFrame:
        state, address = self._state, self.motor.address
        scales = mit.full_scale(address.model)[:3]
        quantities = ("position", "velocity", "torque")
        counts = [to_counts(state[name], -most, most, 16) for name, most in zip(quantities, scales, strict=True)]
        counts.append(round(10 * state["temperature"]) & 0xFFFF)
        mode = robstride.RUNNING if self.enabled else 0
        middle = (mode << 6 | self.fault & robstride.FAULT_BITS) << 8 | address.id
        return robstride.frame_identifier(robstride.FEEDBACK, middle, host), struct.pack(">4H", *counts)


class MoteusMotor(SimulatedMotor):
    """A moteus controller; its gains are the truth's.

    As a real one, it also obeys speed and stop position of a command, which dynid does not send.
    """

    over_temperature, under_voltage, timed_out = 38, 40, moteus.TIMEOUT_MODE
    position_byte = 6

    def __init__(self, motor: CanMotor, index: int, plant: MotorPlant) -> None:
        super().__init__(motor, index, plant)
        self._mode = moteus.STOPPED

    def hear(self, identifier: int, data: bytes, now: float) -> list[CanFrame]:  # noqa: D102
        plain = identifier & ~EXTENDED
        if plain & 0x7F != self.motor.id or plain >> 16 or identifier & REMOTE:
            return []
        answer, written = b"", dict[int, float]()
        try:
            parts = list(moteus.subframes(data))
            for kind, form, first, values in parts:
                if kind == moteus.WRITE and not isinstance(values, int):
                    scale = {moteus.FLOAT: 1.0, moteus.INT16: 1e-4}.get(form, 1e-5)
                    scaled = {n: v * (scale if n in MOVING else 1.0) for n, v in enumerate(values, start=first)}
                    written |= scaled
            self._write(written, now)
            for kind, form, first, values in parts:
                if kind == moteus.READ and isinstance(values, int):
                    contents = [self._register(first + k, form) for k in range(values)]
                    answer += moteus.subframe(moteus.REPLY, form, first, contents)
        except (ValueError, IndexError, struct.error):
            return []
        if not plain & moteus.ANSWER or not answer:
            return []
        return [(self.motor.id << 8 | plain >> 8 & 0x7F, moteus.padded(answer))]

    @property
    def timeout(self) -> float | None:  # noqa: D102
        seconds = self._registers.get(moteus.WATCHDOG, math.nan)
        return None if math.isnan(seconds) else seconds or 0.1

    def hold(self, position: float, now: float) -> None:
        """Hold a position in position mode, without a watchdog."""
        self._mode = moteus.POSITION_MODE
        self._registers[moteus.WATCHDOG] = math.nan
        super().hold(position, now)

    def protect(self, fault: int) -> None:
        """A time-out is a mode of its own."""
        timed_out = fault == moteus.TIMEOUT_MODE
        self._mode = moteus.TIMEOUT_MODE if timed_out else moteus.FAULTY
        self.fault = 0 if timed_out else fault
        self._let_go()

    def restart(self, now: float) -> None:
        """Begin again, stopped."""
        super().restart(now)
        self._mode = moteus.STOPPED

    def _write(self, written: dict[int, float], now: float) -> None:
        """What a whole frame writes."""
        if moteus.MODE in written:
            mode = int(written.pop(moteus.MODE))
            if mode == moteus.STOPPED:
                self._mode, self.fault = mode, 0
                self._let_go()
            elif mode == moteus.POSITION_MODE and self._mode not in (moteus.FAULTY, moteus.TIMEOUT_MODE):
                self._mode = mode
                self._registers = {moteus.GOAL: 0.0, moteus.MOST_TORQUE: math.nan, moteus.WATCHDOG: 0.0}
                self._enable(now)
        if not written:
            return
        self._registers |= {number: value for number, value in written.items() if number != moteus.GOAL}
        if moteus.GOAL in written and self.enabled:
            goal, speed, stop = (
                written.get(number, default) * TURN
                for number, default in ((moteus.GOAL, 0.0), (moteus.SPEED, 0.0), (moteus.STOP, math.nan))
            )
            goal = self._state["position"] if math.isnan(goal) else goal
            most = self._registers.get(moteus.MOST_TORQUE, math.nan)
            self._plant.limit(self.index, None if math.isnan(most) else most)
            pushed, stiff, damped = (
                written.get(number, default)
                for number, default in (
                    (moteus.FEED_FORWARD, 0.0),
                    (moteus.STIFFNESS_SHARE, 1.0),
                    (moteus.DAMPING_SHARE, 1.0),
                )
            )
            shares = stiff, min(stiff, damped)
            self._follow(now, goal, None, 0.0 if math.isnan(speed) else speed, stop, pushed, shares)

    def _register(self, number: int, form: int) -> float:
        state = self._state
        if number == moteus.POSITION:
            value = state["position"] / TURN
        elif number == moteus.POSITION + 1:
            value = state["velocity"] / TURN
        elif number == moteus.TORQUE:
            value = state["torque"]
        else:
            value = {
                moteus.MODE: self._mode,
                moteus.MOTOR_TEMPERATURE: state["temperature"] if self.motor.address.thermistor else 0.0,
                moteus.VOLTAGE: state["supply_voltage"],
                moteus.BOARD_TEMPERATURE: state["drive_temperature"],
                moteus.FAULT: self.fault,
            }.get(number, self._registers.get(number, 0.0))
        if form == moteus.FLOAT:
            return float(value)
        fine = form == moteus.INT16
        step = moteus.SCALES.get(number, 1.0) if fine else {moteus.VOLTAGE: 0.5}.get(number, 1.0)
        return round(value / step)


class OdriveMotor(SimulatedMotor):
    """An ODrive axis; its own watchdog is off."""

    over_temperature, under_voltage, timed_out = 1 << 13, 1 << 9, 1 << 24

    def __init__(self, motor: CanMotor, index: int, plant: MotorPlant) -> None:
        super().__init__(motor, index, plant)
        self._position_gain, self._velocity_gain = 20.0, 0.16
        self.limits = math.inf, math.inf

    def hear(self, identifier: int, data: bytes, now: float) -> list[CanFrame]:  # noqa: D102
        remote, plain = bool(identifier & REMOTE), identifier & ~REMOTE
        command = plain & 0x1F
        everyone = remote and command == odrive.ADDRESS and plain >> 5 == odrive.EVERYONE
        if plain & EXTENDED or (plain >> 5 != self.motor.id and not everyone):
            return []
        if remote:
            return self._told(command)
        if len(data) != 8:
            return []
        if command == odrive.SET_STATE:
            if struct.unpack_from("<I", data)[0] == odrive.CLOSED_LOOP:
                self._enable(now)
            else:
                self._let_go()
        elif command == odrive.CLEAR_ERRORS:
            self.fault = 0
        elif command == odrive.SET_POSITION_GAIN:
            self._position_gain = struct.unpack_from("<f", data)[0]
        elif command == odrive.SET_VELOCITY_GAINS:
            self._velocity_gain = struct.unpack_from("<f", data)[0]
        elif command == odrive.SET_LIMITS:
            self.limits = struct.unpack("<ff", data)
        elif command == odrive.SET_GOAL:
            damping = self._velocity_gain / TURN
            goal = struct.unpack_from("<f", data)[0] * TURN
            self._follow(now, goal, (self._position_gain * damping, damping))
        return []

    def of_other(self, identifier: int, data: bytes) -> bytes:
        """Another axis has the same state, no fault, and a serial number of its own."""
        return super().of_other(identifier, data) if identifier & 0x1F in (odrive.ESTIMATES, odrive.ADDRESS) else data

    def _told(self, command: int) -> list[CanFrame]:
        state = self._state
        payloads = {
            odrive.ESTIMATES: (state["position"] / TURN, state["velocity"] / TURN),
            odrive.TORQUES: (state["torque"], state["torque"]),
            odrive.TEMPERATURES: (state["drive_temperature"], state["temperature"]),
            odrive.SUPPLY: (state["supply_voltage"], 0.0),
        }
        identifier = self.motor.id << 5 | command
        if command == odrive.HEARTBEAT:
            axis = odrive.CLOSED_LOOP if self.enabled else odrive.IDLE
            return [(identifier, struct.pack("<IB3x", self.fault, axis))]
        if command == odrive.ADDRESS:
            return [(identifier, bytes([self.motor.id]) + (SERIAL + self.index).to_bytes(6, "little") + bytes(1))]
        return [(identifier, struct.pack("<ff", *payloads[command]))] if command in payloads else []


SIMULATED: Mapping[str, type[SimulatedMotor]] = {
    "damiao": DamiaoMotor,
    "robstride": RobstrideMotor,
    "cubemars": CubemarsMotor,
    "moteus": MoteusMotor,
    "odrive": OdriveMotor,
}
