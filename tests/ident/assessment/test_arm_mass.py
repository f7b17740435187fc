from __future__ import annotations

import pytest

from daq.robot.loader import parse_robot
from ident.assessment.arm_mass import mass_of_size
from ident.model.dynamic_model import build_model

GANTRY = """\
name: gantry
model:
  mdh:
    - {joint: x, type: prismatic, alpha: pi/2, d: 0, r: 0}
    - {joint: y, antecedent: x, type: prismatic, alpha: pi/2, d: 0.3, r: 0}
joints:
  - {name: x, position: [0, TRAVEL], velocity: 1}
  - {name: y, position: [0, 0.2], velocity: 1}
"""


def test_what_slides_out_of_an_arm_makes_it_longer_than_its_frames_show() -> None:
    """Bodies of a gantry whose frames are 0.3 m apart carry axes of metres."""
    short, long = (
        mass_of_size(build_model(parse_robot(GANTRY.replace("TRAVEL", travel), where="gantry", folder=None)))
        for travel in ("0.2", "3.0")
    )
    assert short is not None
    assert long is not None
    assert long.expected == pytest.approx(short.expected)
    assert long.heaviest_link > 50.0 * short.heaviest_link
