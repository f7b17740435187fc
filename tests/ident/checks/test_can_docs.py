"""What a user copies from docs/can.md is accepted."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml
from each import each
from kinematic_arm import ROBOT_FILE

from daq.motion.trajectory_file import parse_trajectory
from daq.session.connections import driver_settings
from drivers.bus_budget import Budget
from drivers.can_signals.settings import parse_settings as parse_frames
from drivers.canopen402.declaration import synchronous_cycle
from drivers.canopen402.settings import parse_settings as parse_canopen
from drivers.declaration import declared
from drivers.serial_thermometer.settings import parse_settings as parse_thermometer

PAGE = (Path(__file__).resolve().parents[3] / "docs" / "can.md").read_text(encoding="utf-8")
BLOCKS = [
    re.sub(r"^    ", "", block, flags=re.M) if block.startswith("    ") else block
    for block in re.findall(r"```yaml\n(.*?)```", PAGE, re.S)
]
PARSERS = {"canopen402": parse_canopen, "can_frames": parse_frames, "serial_thermometer": parse_thermometer}
CONNECTIONS = {
    keys["driver"]: {key: value for key, value in keys.items() if key != "driver"}
    for block in BLOCKS
    for keys in (yaml.safe_load(block).get("connections") or {}).values()
    if len(keys) > 2
}


@each("driver", PARSERS)
def test_connections_are_accepted(driver: str) -> None:
    keys = CONNECTIONS[driver]
    assert PARSERS[driver](keys, ("shoulder", "elbow"))
    budget = declared(driver).budget_of(driver_settings(ROBOT_FILE.robot, keys))
    assert budget is None or budget.load < 0.8


def test_the_first_motion_is_accepted() -> None:
    (text,) = (block for block in BLOCKS if "kind: points" in block)
    played = parse_trajectory(text.replace("my_arm", "two-links"), ROBOT_FILE.robot, where="docs", folder=None)
    assert played.motion.duration == pytest.approx(16.0)


@each(("label", "tpdos", "rpdos"), [("2 TPDO (", 2, 0), ("2 TPDO, 1 RPDO", 2, 1), ("3 TPDO, 1 RPDO", 3, 1)])
def test_the_table_of_rates_is_what_the_budget_says(label: str, tpdos: int, rpdos: int) -> None:
    budget = Budget(1e6, 1.0, synchronous_cycle(6, [8] * tpdos, [8] * rpdos))
    (row,) = (line for line in PAGE.splitlines() if line.startswith(f"| {label}"))
    assert re.findall(r"(\d+) Hz", row) == [f"{budget.highest_rate(share):.0f}" for share in (1.0, 0.8)]
