"""The URDFs that come with public recordings, exported with other bodies: they stay readable and sane."""

from __future__ import annotations

from pathlib import Path

import pytest
from exported_arms import exported_arm

from daq.robot.loader import load_robot, parse_robot
from ident.export import pinocchio_reading
from ident.export.urdf_edit import edited_urdf

pytestmark = pytest.mark.realdata

TX40 = (Path(__file__).parents[2] / "examples" / "tx40.yaml").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", ["ur10", "panda", "tx40"])
def test_a_published_urdf_has_the_torques_of_the_model(data_dir: Path, name: str) -> None:
    robot_file = (
        parse_robot(TX40, where=name, folder=data_dir) if name == "tx40" else load_robot(data_dir / f"{name}.urdf")
    )
    arm = exported_arm(robot_file)
    text = edited_urdf(arm, robot_file.urdf_text or "", name)
    assert pinocchio_reading.torque_error(arm, text, 200) < 1e-9
    for tag in ("<mesh", "<transmission", "<!--"):
        kept = text.count(tag) - (robot_file.urdf_text or "").count(tag)
        assert kept == (1 if tag == "<!--" else 0)
