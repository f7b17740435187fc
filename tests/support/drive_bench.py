"""A master for tests of simulated drives in virtual time: SDO, the driver's PDO mapping, cycles of RPDOs and SYNC."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from exact_plant import JOINT_NAMES, ExactPlant

from daq.robot.loader import parse_robot
from daq.robot.schema import Robot
from drivers.canopen402.protocol.objects import RPDO_OBJECTS, TPDO_OBJECTS
from drivers.canopen402.settings import CanopenSettings, parse_settings
from sim_drivers.can.bus_load import Frame, Sent, exact_bits
from sim_drivers.canopen.network import DriveNetwork

COUNTS = 524288


def six_joints() -> Robot:
    rows = "\n".join(f"    - {{joint: {name}, alpha: 0, d: 0.1, r: 0}}" for name in JOINT_NAMES)
    joints = "\n".join(
        f"  - {{name: {name}, position: [-6, 6], velocity: 3, acceleration: 8, torque: 150}}" for name in JOINT_NAMES
    )
    text = f"name: six\nmodel:\n  mdh:\n{rows}\njoints:\n{joints}\n"
    return parse_robot(text, where="six", folder=None).robot


def bus_settings(**keys: object) -> CanopenSettings:
    nodes = {name: {"id": number, "counts_per_turn": COUNTS} for number, name in enumerate(JOINT_NAMES, start=1)}
    connection = {"interface": "virtual", "channel": "test", "sync_rate": 400, "nodes": nodes, **keys}
    return parse_settings(connection, JOINT_NAMES)


@dataclass(frozen=True)
class Told:
    """A drive's TPDO at a SYNC."""

    status: int
    mode: int
    position: int


class Bench:
    """Six drives over an arm, and their master."""

    def __init__(
        self,
        arm: ExactPlant | None = None,
        length: Callable[[Frame], int] = exact_bits,
        swapped: tuple[int, int] | None = None,
        **keys: object,
    ) -> None:
        self.arm = ExactPlant() if arm is None else arm
        self.network = DriveNetwork(self.arm, six_joints(), bus_settings(**keys), swapped=swapped, length=length)
        self.time = 0.0
        self.heard: list[Sent] = []

    def pass_time(self, seconds: float) -> list[Sent]:
        end, out = self.time + seconds, []
        while self.time < end:
            self.time = min(self.time + 0.1, end)
            out += self.network.advance(self.time)
        self.heard += out
        return out

    def send(self, identifier: int, data: bytes = b"") -> None:
        self.network.arrive(Frame(identifier, data), self.time)

    def guard(self, node: int) -> bytes | None:
        """What a node answers to a request of node guarding; None where it does not."""
        self.network.arrive(Frame(0x700 + node, b"\0", remote=True), self.time)
        answers = [sent.frame.data for sent in self.pass_time(0.003) if sent.frame.id == 0x700 + node]
        assert len(answers) <= 1
        return answers[0] if answers else None

    def ask(self, node: int, request: bytes) -> bytes:
        self.send(0x600 + node, request)
        answers = [sent.frame.data for sent in self.pass_time(0.003) if sent.frame.id == 0x580 + node]
        assert len(answers) == 1
        return answers[0]

    def write(self, node: int, index: int, subindex: int, value: int, size: int) -> int:
        """0 where it worked, else the abort code."""
        content = (value & (1 << 8 * size) - 1).to_bytes(4, "little")
        answer = self.ask(node, struct.pack("<BHB", 0x23 | 4 - size << 2, index, subindex) + content)
        return 0 if answer[0] == 0x60 else int.from_bytes(answer[4:], "little")

    def read(self, node: int, index: int, subindex: int = 0, signed: bool = False) -> int:
        answer = self.ask(node, struct.pack("<BHB4x", 0x40, index, subindex))
        assert answer[0] & 0xF0 == 0x40, answer.hex()
        return int.from_bytes(answer[4 : 8 - (answer[0] >> 2 & 3)], "little", signed=signed)

    def map_pdos(self, nodes: Sequence[int] = range(1, 7)) -> None:
        """The driver's mapping, and operational."""
        plan = (
            (0x1800, 0x1A00, 0x180, TPDO_OBJECTS[0]),
            (0x1801, 0x1A01, 0x280, TPDO_OBJECTS[1]),
            (0x1400, 0x1600, 0x200, RPDO_OBJECTS),
        )
        for node in nodes:
            for communication, mapping, base, objects in plan:
                assert not self.write(node, communication, 1, 1 << 31 | base + node, 4)
                assert not self.write(node, mapping, 0, 0, 1)
                for place, item in enumerate(objects, start=1):
                    assert not self.write(node, mapping, place, item.mapping, 4)
                assert not self.write(node, mapping, 0, len(objects), 1)
                assert not self.write(node, communication, 2, 1, 1)
                assert not self.write(node, communication, 1, base + node, 4)
        self.send(0, bytes([1, 0]))
        self.pass_time(0.005)

    def cycle(self, word: int, targets: Sequence[int], mode: int = 8, period: float = 0.0025) -> dict[int, Told]:
        """RPDOs of all drives, SYNC, and their TPDOs."""
        for node, target in enumerate(targets, start=1):
            self.send(0x200 + node, struct.pack("<Hbi", word, mode, target))
        # A frame's time on the bus after the last RPDO, so that this SYNC applies them.
        self.pass_time(0.4 * period)
        self.send(0x80)
        out = self.pass_time(0.6 * period)
        controlwords = {}
        for sent in out:
            if 0x180 < sent.frame.id <= 0x186:
                controlwords[sent.frame.id - 0x180] = Told(*struct.unpack("<Hbi", sent.frame.data))
        return controlwords

    def enable(self, mode: int = 8) -> list[int]:
        """Operation enabled at the present position; the counts there."""
        controlwords = self.cycle(0x00, [0] * 6, mode)
        targets = [controlwords[node].position for node in range(1, 7)]
        for word in (0x06, 0x07, 0x0F):
            controlwords = self.cycle(word, targets, mode)
        assert {one.status & 0x6F for one in controlwords.values()} == {0x27}
        return targets

    def emergencies(self) -> list[tuple[int, int, int]]:
        """(node, error code, error register) of what was said so far."""
        return [
            (sent.frame.id - 0x80, *struct.unpack_from("<HB", sent.frame.data))
            for sent in self.heard
            if 0x80 < sent.frame.id < 0x100
        ]
