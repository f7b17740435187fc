from __future__ import annotations

import pytest
from each import each
from hypothesis import given
from hypothesis import strategies as st

from daq.robot.loader import load_robot, parse_robot
from ident.assessment.arm_mass import PER_PAYLOAD, end_shown, mass_of_size
from ident.identify.checks.body_checks import WRIST, _total_checks
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


def test_three_axes_through_one_point_do_not_show_how_large_the_last_body_is() -> None:
    """On such a random arm of 24 kg the torques, 0.3 % off, were those of 4,900 kg of the body that was assumed."""
    beyond = GANTRY.replace("TRAVEL", "1").replace("d: 0.3, r: 0", "d: 0, r: 0")
    assert end_shown(build_model(parse_robot(GANTRY.replace("TRAVEL", "1"), where="gantry", folder=None)))
    assert not end_shown(build_model(parse_robot(beyond, where="gantry", folder=None)))
    assert end_shown(build_model(load_robot("ur5e")))


@each("name", ["ur5e", "ur10", "ur10e", "panda", "aubo_i5"])
def test_the_built_in_arms_weigh_what_their_payload_lets_expect(name: str) -> None:
    robot = load_robot(name).robot
    assert robot.payload is not None
    mass = sum(link.mass for link in robot.truth.links.values())
    assert PER_PAYLOAD[0] < mass / robot.payload < PER_PAYLOAD[1]
    (check,) = _total_checks(None, None, robot.payload, 0.1 * mass)
    assert check.name == "implausible-mass"


@given(st.floats(1e-2, 1e3), st.floats(1e-3, 1e5))
def test_a_mass_is_implausible_beside_a_payload_by_their_ratio_alone(payload: float, apparent: float) -> None:
    allowed = PER_PAYLOAD[0] / WRIST <= apparent / payload <= PER_PAYLOAD[1]
    assert bool(_total_checks(None, None, payload, apparent)) is not allowed
    assert _total_checks(None, None, None, apparent) == []
