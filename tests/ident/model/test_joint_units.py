"""Units of sliding joints, and of columns that hold several joints."""

from __future__ import annotations

import pytest

from ident.model.joint_units import common_unit


@pytest.mark.parametrize(
    ("unit", "sliding", "shown"),
    [
        ("N·m", (False, False), "N·m"),
        ("N·m", (True, True), "N"),
        ("N·m", (True, False), "N·m or N"),
        ("rad/s", (True,), "m/s"),
        ("N·m·(s/rad)^α", (True,), "N·(s/m)^α"),
        ("N·m", (), "N·m"),
    ],
)
def test_unit_of_a_column(unit: str, sliding: tuple[bool, ...], shown: str) -> None:
    assert common_unit(unit, sliding) == shown
