"""Recordings and robot files of one arm and of others."""

from __future__ import annotations

from dataclasses import replace

import pytest

import dynid
from daq.robot.loader import load_robot
from drivers.core.errors import DataError
from ident.model.another_arm import another_arm, check_arm, check_one_arm, robot_sha256


def test_another_arm_is_named() -> None:
    file = load_robot("ur5e")
    assert another_arm(file, load_robot("ur5e")) == ""
    assert "is placed differently" in another_arm(file, load_robot("ur10e"))
    assert "with joints" in another_arm(file, load_robot("sr400"))


def test_recordings_of_arms_with_equal_joint_names_are_told_apart() -> None:
    """Both have six joints of the same names: nothing but the geometry tells."""
    small, large = (dynid.simulate(robot, duration=2.0, seed=1, rate=100.0) for robot in ("ur5e", "ur10e"))
    with pytest.raises(DataError, match=r"is of ur10e, not of ur5e: joint .* is placed differently"):
        dynid.identify([small, large])
    with pytest.raises(DataError, match="is of ur10e"):
        dynid.identify(small, validation=large)
    renamed = replace(large, robot_text=large.robot_text.replace("name: ur10e", "name: ur5e"))
    with pytest.raises(DataError, match=r"is of another ur5e: joint \w+ is placed differently \("):
        check_arm([small, renamed], load_robot("ur5e"))
    check_arm([small, renamed, replace(large, robot_text="")], load_robot("ur5e"), {robot_sha256(renamed)})


def test_a_robot_file_that_differs_is_refused_with_what_differs() -> None:
    """The name alone makes no arm: order and names of joints, place, mounting and coupling of its motors count."""
    run, file = dynid.simulate("ur5e", duration=0.5, seed=1, rate=100.0), load_robot("ur5e")
    first, second = file.robot.joint_names[1:3]
    swapped = run.robot_text.replace(first, "@").replace(second, first).replace("@", second)
    other = {
        swapped: "with joints",
        run.robot_text.replace("[0, 0, -9.81]", "[0, 0.5, -9.79]"): "has gravity",
        run.robot_text.replace(
            "  mdh:", f"  coupling: {{{first}: {{{first}: 1, {second}: 0.5}}}}\n  mdh:"
        ): "coupled otherwise",
        run.robot_text.replace("d: -0.425", "d: -0.43"): "is placed differently",
    }
    assert len(other) == 4
    assert run.robot_text not in other
    for text, message in other.items():
        with pytest.raises(DataError, match=message):
            check_arm([replace(run, robot_text=text)], file)
    payload = run.robot_text.replace("payload: 5", "payload: 6")
    assert payload != run.robot_text
    check_arm([replace(run, robot_text=payload)], file)


def test_an_experiment_takes_recordings_of_one_arm_mounted_in_one_way() -> None:
    run = dynid.simulate("ur5e", duration=1.0, seed=1, rate=100.0)
    turned = run.robot_text.replace("gravity: [0, 0, -9.81]", "gravity: [0, 1, -9.76]")
    assert turned != run.robot_text
    check_one_arm([run, run])
    with pytest.raises(DataError, match=r"has gravity \(0.0, 1.0, -9.76\), not"):
        check_one_arm([run, replace(run, robot_text=turned)])
