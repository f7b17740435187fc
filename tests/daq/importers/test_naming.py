"""What the names in foreign files mean, and choices that cannot be."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from each import each
from hypothesis import given
from hypothesis import strategies as st

from daq.importers.choices import ImportChoices
from daq.importers.naming import parse_name
from drivers.core.errors import UsageError

NAMES = ("shoulder", "elbow", "wrist")


@each(
    ("name", "expected"),
    [
        ("q1", ("position", 1, None, "")),
        ("q_12", ("position", 12, None, "")),
        ("Q[3]", None),
        ("Position [deg]", ("position", None, None, "deg")),
        ("q1 [deg]", ("position", 1, None, "deg")),
        ("q1_deg", ("position", 1, None, "deg")),
        ("q[1]", ("position", 1, None, "")),
        ("t_ms", ("time", None, None, "ms")),
        ("tau_J", ("torque", None, None, "")),
        ("tau_J_2", ("torque", 2, None, "")),
        ("I1 (A)", ("current", 1, None, "A")),
        ("dq2", ("velocity", 2, None, "")),
        ("q_motor", None),
        ("T", None),
        ("t1", None),
        ("elbow_position", ("position", None, "elbow", "")),
        ("effort[elbow]", ("effort", None, "elbow", "")),
        ("velocity.elbow [deg/s]", ("velocity", None, "elbow", "deg/s")),
        ("data.q", ("position", None, None, "")),
        ("", None),
        ("elbow", None),
        ("Joint 1 position (deg)", ("position", 1, None, "deg")),
        ("joint_1_position", ("position", 1, None, "")),
        ("J1_pos", ("position", 1, None, "")),
        ("Axis 2 Actual Velocity [deg/s]", ("velocity", 2, None, "deg/s")),
        ("ActualPositionAxis3", ("position", 3, None, "")),
        ("position joint 1", ("position", 1, None, "")),
        ("Joint[2].position", ("position", 2, None, "")),
        ("Motor current 3 (mA)", ("current", 3, None, "mA")),
        ("cur1", ("current", 1, None, "")),
        ("Joint positions", ("position", None, None, "")),
        ("Joint 1", None),
        ("Joint 1 target position", None),
        ("Joint 1 position error", None),
        ("Motor position 1", None),
        ("Motor 1 torque", None),
        ("Joint 1 position 2", None),
        ("Joint 1 time", None),
        ("x1 position 1", None),
    ],
)
def test_what_names_mean(name: str, expected: tuple[object, ...] | None) -> None:
    role = parse_name(name, NAMES)
    found = None if role is None else (role.quantity, role.number, role.joint, role.unit)
    assert found == expected


SHAPES = ["{joint}{between}{number}{between2}{word}", "{word}{between2}{joint}{between}{number}"]


@given(
    shape=st.sampled_from(SHAPES),
    joint=st.sampled_from(["Joint", "joint", "AXIS", "J", "jnt"]),
    between=st.sampled_from(["", " ", "_", "-"]),
    number=st.integers(0, 99),
    between2=st.sampled_from([" ", "_", "/", ": "]),
    word=st.sampled_from(["position", "Velocity", "TORQUE", "current", "Actual position", "measured_current", "temp"]),
    unit=st.sampled_from(["", " [deg]", " (A)", "[N·m]"]),
)
def test_a_joints_number_and_quantity_are_understood_in_any_order(
    shape: str, joint: str, between: str, number: int, between2: str, word: str, unit: str
) -> None:
    name = shape.format(joint=joint, between=between, number=number, between2=between2, word=word) + unit
    role = parse_name(name, NAMES)
    assert role is not None
    quantity = {"actual position": "position", "measured_current": "current", "temp": "temperature"}
    assert (role.quantity, role.number) == (quantity.get(word.casefold(), word.casefold()), number)
    assert role.unit == unit.strip(" []()")


@given(st.text(max_size=12))
def test_any_name_is_parsed(name: str) -> None:
    role = parse_name(name, NAMES)
    assert role is None or role.name == name


@each(
    ("choices", "message"),
    [
        ({"repair": frozenset({"drop-nans"})}, "unknown repair 'drop-nans'.*did you mean 'drop-nan'"),
        ({"effort": "force"}, "--effort .* does not exist .torque or current."),
        ({"rate": 0.0}, "--rate .* is not (within|a finite number)"),
        ({"rate": float("nan")}, "--rate .* is not (within|a finite number)"),
        ({"time_unit": "min"}, "--time-unit .* does not exist .s, ms, us or ns."),
    ],
)
def test_choices_that_cannot_be(choices: dict[str, Any], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        replace(ImportChoices(), **choices)
