"""One simulated servo: its memory, and what writing to it and asking it do."""

from __future__ import annotations

from drivers.serial_servos.cycle import ALERT
from drivers.serial_servos.registers import ServoTable
from drivers.serial_servos.settings import ServoMotor
from sim_drivers.plant.clocked_arm import POWER_UP

MEMORY = 256
"""Bytes of a servo's memory."""
ACCESS, RANGE = 7, 6
"""Errors of a Dynamixel servo: the memory is read only, the value is out of range."""
WATCHDOG_FIRED = 0xFF

DEFAULTS = {
    "feetech": {"torque_limit": 1000, "status_level": 1, "p_gain": 16, "lock": 1, "max_torque": 1000},
    "dynamixel": {
        "torque_limit": 885,
        "max_torque": 885,
        "status_level": 2,
        "operating_mode": 3,
        "p_gain": 800,
        "firmware": 45,
        "return_delay": 250,
    },
}
"""What a servo's registers hold when its power comes on, or as it leaves the factory; the others 0."""


class SimulatedServo:
    """Memory and state of a servo; the plant behind it is the server's.

    The calibration of the motor, where it has one, is in its EEPROM; the voltage [V] is its supply's.

    Attributes:
        motor: as given.
        dead: whether it neither answers nor drives.
        silent_until: until when its power comes up [s, host's clock].
        errors: bits of its status.
        asked: when the last instruction was heard [s, host's clock].
        signed: whether its current has a sign.
    """

    def __init__(self, motor: ServoMotor, voltage: float) -> None:
        self.motor, self.table = motor, motor.table
        self.dead = False
        self.silent_until = self.asked = float("-inf")
        self.errors = 0
        self.signed = "current" not in motor.table.magnitudes
        self._memory = bytearray(MEMORY)
        self._written = self._writable(motor.table)
        calibration = motor.calibration
        lowest, highest = (
            (0, motor.table.steps - 1) if calibration is None else (calibration.lowest, calibration.highest)
        )
        own = {
            "model_number": motor.table.number,
            "id": motor.id,
            "min_position": lowest,
            "max_position": highest,
            "max_temperature": 70,
            "max_voltage": round(1.2 * voltage / motor.table.registers["max_voltage"].scale),
            "min_voltage": round(0.5 * voltage / motor.table.registers["min_voltage"].scale),
            "homing_offset": 0 if calibration is None else calibration.homing_offset,
        }
        for name, counts in (DEFAULTS[motor.table.protocol] | own).items():
            if name in motor.table.registers:
                self.put(name, counts)

    def get(self, name: str) -> int:
        """The counts of a register."""
        entry = self.table.registers[name]
        return entry.decoded(bytes(self._memory[entry.address : entry.address + entry.size]))

    def put(self, name: str, counts: int) -> None:
        """Set a register, also a read-only one; counts beyond its bounds become its bounds."""
        entry = self.table.registers[name]
        least, most = entry.bounds
        data = entry.encoded(min(max(counts, least), most))
        self._memory[entry.address : entry.address + entry.size] = data

    def holds(self, name: str) -> bool:
        """Return whether the model has a register."""
        return name in self.table.registers

    def read(self, address: int, size: int) -> bytes:
        """Bytes of the memory, and of those that it shows in others' place; nothing beyond its end."""
        if address + size > MEMORY:
            return b""
        return bytes(self._memory[self._shown(place)] for place in range(address, address + size))

    def _shown(self, place: int) -> int:
        """The address of the byte that an address shows."""
        indirect = self.table.indirect
        if indirect is None or not 0 <= place - indirect.data < indirect.count:
            return place
        word = indirect.address + 2 * (place - indirect.data)
        return int.from_bytes(self._memory[word : word + 2], "little") or place

    def write(self, address: int, data: bytes) -> int:
        """Write into the memory as a client does; the error of a Dynamixel servo, 0 where it obeys."""
        if not all(place in self._written for place in range(address, address + len(data))):
            return ACCESS
        indirect = self.table.indirect
        if indirect is not None and address >= indirect.address and self.get("torque_enable"):
            return ACCESS  # as ROBOTIS' example of indirect addresses says
        eeprom = {entry.address for entry in self.table.registers.values() if entry.eeprom}
        if self.table.protocol == "dynamixel":
            if self.get("torque_enable") and any(place in eeprom for place in range(address, address + len(data))):
                return ACCESS  # the EEPROM is locked while the torque is on
            goal, watchdog = self.table.registers["goal_position"], self.table.registers["bus_watchdog"]
            fired = self._memory[watchdog.address] == WATCHDOG_FIRED
            if fired and goal.address <= address < goal.address + goal.size:
                return RANGE
        enabled = self.get("torque_enable")
        self._memory[address : address + len(data)] = data
        if self.table.protocol == "dynamixel" and not enabled and self.get("torque_enable"):
            if self.errors:
                self.put("torque_enable", 0)  # not before a reboot
            self.put("goal_position", self.get("present_position"))
        return 0

    def restart(self, now: float) -> None:
        """Interrupt its power: the RAM is as at the start, the torque off, and it is silent for a while."""
        self.silent_until = now + POWER_UP
        self.errors = 0
        for name, entry in self.table.registers.items():
            if not entry.eeprom:
                self.put(name, DEFAULTS[self.table.protocol].get(name, 0))
        if (indirect := self.table.indirect) is not None:
            self._memory[indirect.address : indirect.address + 2 * indirect.count] = bytes(2 * indirect.count)

    def protect(self, bit: int) -> None:
        """Go into a fault: its bit is set, the torque off."""
        self.errors |= 1 << bit
        self.put("torque_enable", 0)

    def watch(self, now: float) -> None:
        """Let the bus watchdog fire where the bus was silent for its time."""
        if not self.holds("bus_watchdog") or not self.get("torque_enable"):
            return
        entry = self.table.registers["bus_watchdog"]
        limit = self._memory[entry.address]
        if 0 < limit < 128 and now - self.asked > limit * entry.scale:
            self._memory[entry.address] = WATCHDOG_FIRED
            self.put("goal_position", self.get("present_position"))

    @property
    def answer_code(self) -> int:
        """The errors in its answers."""
        if self.table.protocol == "feetech":
            return self.errors
        return ALERT if self.errors else 0

    @property
    def effort(self) -> float:
        """Largest share of the full duty cycle that it may use."""
        if self.dead or not self.get("torque_enable"):
            return 0.0
        if "torque_limit" not in self.table.registers:
            return 1.0
        return min(1.0, self.get("torque_limit") * self.table.registers["torque_limit"].scale)

    def _writable(self, table: ServoTable) -> frozenset[int]:
        own = [
            entry
            for name, entry in table.registers.items()
            if not name.startswith("present_") and name not in ("model_number", "firmware", "status", "moving")
        ]
        places = {place for entry in own for place in range(entry.address, entry.address + entry.size)}
        if (indirect := table.indirect) is not None:
            places |= {*range(indirect.address, indirect.address + 2 * indirect.count)}
        return frozenset(places)
