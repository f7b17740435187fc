"""What the names in foreign files mean, and choices that cannot be."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from daq.importers import ImportChoices
from daq.importers.naming import parse_name
from drivers.errors import UsageError

NAMES = ("shoulder", "elbow", "wrist")


@pytest.mark.parametrize(
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
    ],
)
def test_what_names_mean(name: str, expected: tuple[object, ...] | None) -> None:
    role = parse_name(name, NAMES)
    found = None if role is None else (role.quantity, role.number, role.joint, role.unit)
    assert found == expected


@given(st.text(max_size=12))
def test_any_name_is_parsed(name: str) -> None:
    role = parse_name(name, NAMES)
    assert role is None or role.name == name


@pytest.mark.parametrize(
    ("choices", "message"),
    [
        ({"repair": frozenset({"drop-nans"})}, "unknown repair 'drop-nans'.*did you mean 'drop-nan'"),
        ({"effort": "force"}, "effort is either torque or current"),
        ({"rate": 0.0}, "a rate is a positive number"),
        ({"rate": float("nan")}, "a rate is a positive number"),
        ({"time_unit": "min"}, "a time unit is one of"),
    ],
)
def test_choices_that_cannot_be(choices: dict[str, Any], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        replace(ImportChoices(), **choices)
