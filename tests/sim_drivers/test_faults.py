"""Faults as they are typed: every row of the table, and what is refused."""

from __future__ import annotations

from pathlib import Path

import pytest
from each import each

from drivers.core.errors import UsageError
from sim_drivers import faults

JOINTS = ("pan", "elbow")
TYPED: dict[str, tuple[str, tuple[object, ...]]] = {
    "drop N": ("drop 5", (5,)),
    "freeze SECONDS": ("  freeze 0.5 ", (0.5,)),
    "cut": ("cut", ()),
    "protective-stop": ("protective-stop", ()),
    "local-control": ("local-control", ()),
    "mute IDENTIFIER SECONDS": ("mute 0x182 0.5", (0x182, 0.5)),
    "clock-jump JUMP": ("clock-jump -0.5", (-0.5,)),
    "power-cycle JOINT": ("power-cycle 2", (1,)),
    "heartbeat-stop JOINT": ("heartbeat-stop pan", (0,)),
    "over-temperature JOINT": ("over-temperature elbow", (1,)),
    "bus-off SECONDS": ("bus-off 2", (2.0,)),
    "truncate N": ("truncate 1", (1,)),
    "garbage N": ("garbage 2", (2,)),
    "heat JOINT CELSIUS": ("heat elbow 12.5", (1, 12.5)),
    "block JOINT": ("block 2", (1,)),
    "drift JOINT RAD/S": ("drift 1 -0.5", (0, -0.5)),
    "stick QUANTITY JOINT": ("stick current elbow", ("current", 1)),
    "stick": ("stick", ()),
    "refuse VARIABLE": ("refuse safety_mode", ("safety_mode",)),
    "silent SECONDS": ("silent 3", (3.0,)),
    "garbage SECONDS": ("garbage 0.5", (0.5,)),
    "unplug": ("unplug", ()),
    "unplug SECONDS": ("unplug 2.5", (2.5,)),
    "replug": ("replug", ()),
    "die JOINT": ("die pan", (0,)),
    "same-id JOINT": ("same-id 2", (1,)),
    "sag SECONDS": ("sag 0.5", (0.5,)),
    "wrong-sum N": ("wrong-sum 3", (3,)),
    "latency SECONDS": ("latency 0.016", (0.016,)),
    "echo": ("echo", ()),
}
SERVERS: tuple[faults.ServerKind, ...] = (
    "UR controller",
    "CANopen drives",
    "signal-table arm",
    "serial servos",
    "CAN motors",
    "thermometer",
    "arm at rest",
)


@each("server", SERVERS)
def test_a_server_obeys_the_faults_of_its_usage_text_and_no_others(server: faults.ServerKind) -> None:
    assert {entry.usage for entry in faults.FAULTS} == set(TYPED)
    obeyed = faults.usage(server).removeprefix("thermometer ").split(" | ")
    words = {(row.split()[0], len(row.split())) for row in obeyed}
    for row, (line, values) in TYPED.items():
        if row in obeyed:
            assert faults.parse_fault(line, server, JOINTS) == faults.Fault(row.split()[0], values)
        elif (row.split()[0], len(row.split())) not in words:
            with pytest.raises(UsageError, match=f"'{line.strip()}' is not a fault of the {server}") as refused:
                faults.parse_fault(line, server, JOINTS)
            assert refused.value.hint == faults.usage(server)


OUT_OF_BOUNDS = [
    "",
    "boom",
    "drop",
    "drop -1",
    "drop 0",
    "truncate 0",
    "freeze nan",
    "freeze -1",
    "freeze inf",
    "bus-off nan",
    "heat 3 1",
    "heat 0 1",
    "heat pan",
    "heat pan cold",
    "heat pan 1001",
    "block",
    "block wrist",
    "stick force elbow",
    "stick position wrist",
    "power-cycle",
    "power-cycle 3",
    "drift 1",
    "drift 1 inf",
    "clock-jump",
    "clock-jump nan",
    "mute 0x182",
    "mute 0x182 -1",
    "mute pan 1",
    "unplug 0",
]


@each("server", SERVERS)
def test_a_word_or_an_argument_out_of_its_bounds_is_refused(server: faults.ServerKind) -> None:
    for line in OUT_OF_BOUNDS:
        with pytest.raises(UsageError):
            pytest.fail(f"{line!r} is taken: {faults.parse_fault(line, server, JOINTS)}")


def test_the_docs_have_every_fault():
    """A row of docs/faults.md begins with each fault as it is typed; thermometers' with the word `thermometer`."""
    page = (Path(__file__).parents[2] / "docs" / "faults.md").read_text(encoding="utf-8")
    table = page.split("## Faults that are typed into")[1]
    typed = {
        cell.strip("` ")
        for row in table.splitlines()
        if row.startswith("| `")
        for cell in row.split("|")[1].split(", ")
    }
    for entry in faults.FAULTS:
        assert {entry.usage, f"thermometer {entry.usage}"} & typed, entry.usage
