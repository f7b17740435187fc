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


@each(("words", "rpdos"), [("recorded at", 0), ("1 RPDO more) at", 1)])
def test_the_rates_are_what_the_budget_says(words: str, rpdos: int) -> None:
    budget = Budget(1e6, 1.0, synchronous_cycle(6, [8, 8], [8] * rpdos))
    assert f"{words} {budget.highest_rate(0.8):.0f} Hz" in " ".join(PAGE.split())
