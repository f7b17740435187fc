"""General closed loops that a robot file gives wrongly: what is refused, with which reason."""

from __future__ import annotations

import numpy as np
import pytest
from loop_arms import FOUR_BAR, four_bar_arm, spatial_arm

from daq.robot.loader import parse_robot
from drivers.core.errors import RobotFileError
from ident.model.dynamic_model import build_model
from ident.model.kinematics.linkages.closed_loops import ClosedLoops

START = "{coupler: 1.0, rocker: -1.3}"
REFUSED = {
    "too long a way": (
        {"antecedent: turn, alpha: -pi/2, d: 0.5": "antecedent: turn, alpha: -pi/2, d: 1.3"},
        r"loop of coupler, rocker does not close: its closing frames stay \d+ mm apart at its start \(crank = -1.4\)",
        "'closing'",
    ),
    "another assembly": (
        {START: "{coupler: -1, rocker: 0.3}"},
        r"closes only .* rad away from the start that 'passive' gives: at coupler = .*, in place of -1",
        "start of the intended assembly",
    ),
    "axes that are not parallel": (
        {"{antecedent: coupler, d: 0.5}": "{antecedent: coupler, alpha: 0.1, d: 0.5}"},
        r"axes stay 5.73° from parallel",
        "angles",
    ),
    "an axis that is not quite parallel": (
        {"antecedent: crank, alpha: 0, d: 0.25, r: 0}": "antecedent: crank, alpha: 1.0e-7, d: 0.25, r: 0}"},
        r"the closing equations determine \d joints?, but 2 have",
        "not quite parallel",
    ),
    "not everywhere": (
        {"d: 0.25, r: 0}": "d: 0.45, r: 0}", "[-2.4, -0.4]": "[-3, 0.2]", START: "{coupler: 1.2, rocker: -1.2}"},
        r"does not close: its closing frames stay [\d.]+ mm apart at crank = .*, within the position limits",
        "narrow the position limits",
    ),
    "limits without end": (
        {"[-2.4, -0.4]": "[-318310*pi, 318310*pi]", START: START + "\n      at: {crank: -1.4}"},
        r"joint crank may move by 2e\+06 rad; a loop is followed over 200 at most",
        "narrow its position limits",
    ),
    "a joint outside of the loop": (
        {
            START: "{coupler: 1.0, rocker: -1.3, wrist: 0}",
            "  - {name: wrist, position: [-2, 2], velocity: 3, torque: 20}\n": "",
            "  - {joint: wrist, gain: 5, gain_std: 0.1}\n": "",
            "    wrist: {viscous: 0.5, coulomb: 0.6, offset: 0.1, motor_inertia: 0.05}\n": "",
            ", wrist: 0.08}": "}",
        },
        r"joint wrist does not lie between its closing frames.*coupler, crank, rocker",
        "",
    ),
}


@pytest.mark.parametrize(("changes", "words", "hint"), REFUSED.values(), ids=REFUSED.keys())
def test_refused_with_the_reason(changes: dict[str, str], words: str, hint: str) -> None:
    with pytest.raises(RobotFileError, match=words) as caught:
        build_model(four_bar_arm(**changes))
    assert hint in caught.value.hint
    assert caught.value.where == "arm.yaml: model.loops"
    assert caught.value.exit_status == 2


def test_too_many_and_too_few_joints_that_follow_are_refused() -> None:
    with pytest.raises(RobotFileError, match=r"equations determine 3 joints, but 4 have") as caught:
        build_model(
            spatial_arm(
                **{
                    "{bow: 0.3, rod: 0.2, rocker: 0.3}": "{bow: 0.3, rod: 0.2, rocker: 0.3, crank: 0}",
                    "  - {name: crank, position: [-1.2, 1.2], velocity: 2}\n": "",
                }
            )
        )
    assert "fewer joints can follow" in caught.value.hint
    with pytest.raises(RobotFileError, match=r"equations determine 5 joints, but 3 have|does not close"):
        build_model(spatial_arm(**{"      opened: spherical\n": ""}))


def change_point(limits: str, crank: str = "1.2") -> str:
    """A parallelogram linkage, which folds flat where all of its joints lie in a line."""
    return (
        "name: folds\nmodel:\n  mdh:\n    - {joint: crank, alpha: 0, d: 0, r: 0}\n"
        "    - {joint: coupler, antecedent: crank, alpha: 0, d: 0.2, r: 0}\n"
        "    - {joint: rocker, alpha: 0, d: 0.5, r: 0}\n"
        f"  loops:\n    - passive: {{coupler: -{crank}, rocker: {crank}}}\n      at: {{crank: {crank}}}\n"
        "      closing:\n"
        "        - {antecedent: coupler, d: 0.5}\n        - {antecedent: rocker, d: 0.2}\n"
        f"joints:\n  - {{name: crank, position: {limits}, velocity: 2}}\n"
    )


def test_a_dead_point_within_the_limits_is_refused_and_found() -> None:
    inside = build_model(parse_robot(change_point("[0.2, 3.0]"), where="x", folder=None))
    assert isinstance(inside.transmission, ClosedLoops)
    tree = inside.tree_position(np.linspace(0.2, 3.0, 20)[None])
    np.testing.assert_allclose(tree[2], tree[0], atol=1e-12)
    with pytest.raises(RobotFileError, match=r"a dead point lies within the position limits, at crank = ") as caught:
        build_model(parse_robot(change_point("[-1.0, 3.0]"), where="x", folder=None))
    assert abs(float(str(caught.value).split("crank = ")[1].split(":")[0])) < 0.05
    with pytest.raises(RobotFileError, match="the start is a dead point"):
        build_model(parse_robot(change_point("[-1.0, 3.0]", crank="0.0"), where="x", folder=None))


def test_a_start_that_is_only_near_is_corrected() -> None:
    exact = build_model(four_bar_arm()).transmission
    near = build_model(four_bar_arm(**{START: "{coupler: 1.3, rocker: -1.2}"})).transmission
    assert isinstance(exact, ClosedLoops)
    assert isinstance(near, ClosedLoops)
    np.testing.assert_allclose(exact.start, near.start, atol=1e-12)


def test_the_start_may_be_given_elsewhere() -> None:
    text = FOUR_BAR.replace("{coupler: 1.0, rocker: -1.3}", "{coupler: 1.4, rocker: -1.9}\n      at: {crank: -2.2}")
    model = build_model(parse_robot(text, where="x", folder=None))
    assert isinstance(model.transmission, ClosedLoops)
    assert model.transmission.start[1] == -2.2
    position = np.array([[0.0], [-1.0], [0.0]])
    np.testing.assert_allclose(
        model.tree_position(position), build_model(four_bar_arm()).tree_position(position), atol=1e-12
    )
