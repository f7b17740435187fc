"""Units and their spellings."""

from __future__ import annotations

import math

import pytest
from each import each

from drivers.core.units import FACTORS, common_unit, conversion, factors, normalised


@each(
    ("written", "value", "expected"),
    [
        ("rad", 2.0, 2.0),
        ("°", 180.0, math.pi),
        ("º", 180.0, math.pi),
        ("Degrees", 90.0, math.pi / 2),
        ("mdeg", 180e3, math.pi),
        ("rev", 0.5, math.pi),
        ("µrad", 3.0, 3e-6),
        ("°/s", 360.0, 2 * math.pi),
        ("1/min", 30.0, math.pi),
        ("rpm", 30.0, math.pi),
        ("mm/s", 5.0, 5e-3),
        ("rad/s²", 3.0, 3.0),
        ("deg/s**2", 180.0, math.pi),
        ("rpm / s", 60.0, 2 * math.pi),
        ("N·m", 4.0, 4.0),
        ("N*m", 4.0, 4.0),
        ("kN", 4.0, 4e3),
        ("mA", 4.0, 4e-3),
        ("μs", 4.0, 4e-6),
        ("°C", 21.0, 21.0),
        ("K", 273.15, 0.0),
        ("°F", 32.0, 0.0),
        ("f", 212.0, 100.0),
        ("", 7.0, 7.0),
    ],
)
def test_what_is_written_becomes_si(written: str, value: float, expected: float) -> None:
    factor, offset = conversion(normalised(written))
    assert factor * value + offset == pytest.approx(expected, abs=1e-12)


def test_every_unit_is_spelled_as_it_is_looked_up() -> None:
    assert [normalised(unit) for unit in FACTORS] == list(FACTORS)
    assert all(factor > 0.0 for factor in FACTORS.values())


def test_the_order_of_a_quantitys_units_is_kept_for_messages() -> None:
    assert list(factors("rpm", "rad/s")) == ["rpm", "rad/s"]
    with pytest.raises(KeyError):
        factors("furlong")


@each(
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
