"""Lengths that tell one six-axis arm from another, from any frames of a robot file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from daq.robot.arm_lengths import arm_lengths
from daq.robot.loader import load_robot

UR5E = [0.425, 0.3922, 0.1333, 0.0997]
ORIGINS = {  # of Universal Robots' own URDF, with the elbow's frame 7 cm along its axis
    "pan": ("0 0 0.1625", "0 0 0"),
    "lift": ("0 0 0", "1.570796327 0 0"),
    "elbow": ("-0.425 0 0.07", "0 0 0"),
    "wrist1": ("-0.3922 0 0.0633", "0 0 0"),
    "wrist2": ("0 -0.0997 0", "1.570796327 0 0"),
    "wrist3": ("0 0.0996 0", "1.570796327 3.141592654 3.141592654"),
}


def test_they_are_those_of_the_makers_table() -> None:
    np.testing.assert_allclose(arm_lengths(load_robot("ur5e")), UR5E)
    assert arm_lengths(load_robot("panda")) is None  # seven axes
    assert arm_lengths(load_robot("up6")) is None  # a closed loop


@pytest.mark.parametrize("axis", ["0 0 1", "0 0 -2"])
def test_a_urdf_has_the_same_wherever_its_frames_are(tmp_path: Path, axis: str) -> None:
    links, parent = ["base", "mount"], "mount"
    text = '<joint name="foot" type="fixed"><parent link="base"/><child link="mount"/><origin rpy="0 0 1"/></joint>'
    for name, (xyz, rpy) in ORIGINS.items():
        text += (
            f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{name}_link"/>'
            f'<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>'
            '<limit lower="-3" upper="3" velocity="3" effort="99"/></joint>'
        )
        parent = f"{name}_link"
        links.append(parent)
    text = "".join(f'<link name="{link}"/>' for link in links) + text
    path = tmp_path / "arm.urdf"
    path.write_text(f'<robot name="arm">{text}</robot>')
    np.testing.assert_allclose(arm_lengths(load_robot(path)), UR5E, atol=1e-8)
