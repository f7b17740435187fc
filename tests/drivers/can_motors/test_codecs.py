"""Frames of CAN motors: what is packed is what is told, and nonsense is no answer."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from motor_bench import JOINTS, WIRES, keys_of

from drivers.base import DriverSettings
from drivers.bus_budget import fd_frame_bits
from drivers.can_motors import mit, moteus
from drivers.can_motors.settings import parse_settings
from drivers.can_motors.tables import FAMILIES, motor_family
from drivers.core.errors import UsageError
from drivers.declaration import declared

DM4310 = motor_family("damiao").models["dm4310"]


def test_tables_are_complete():
    for name in FAMILIES:
        family = motor_family(name)
        assert family.documents
        for model, scale in family.models.items():
            if name in ("damiao", "robstride", "cubemars"):
                assert min(mit.full_scale(scale)) > 0.0, model
        assert family.fault_words(0) == []
        assert family.fault_words(1 << 29 if family.bits else 200)


@given(st.floats(-12.5, 12.5), st.floats(-30, 30), st.floats(0, 500), st.floats(0, 5), st.floats(-10, 10))
def test_goals_of_mit_mode_are_what_was_packed(position, velocity, kp, kd, torque):
    goal = (position, velocity, kp, kd, torque)
    counts = (65535, 4095, 4095, 4095, 4095)
    spans = (25.0, 60.0, 500.0, 5.0, 20.0)
    for told, given_value, span, most in zip(
        mit.unpack_goal(DM4310, mit.pack_goal(DM4310, goal)), goal, spans, counts, strict=True
    ):
        assert abs(told - given_value) <= 0.5001 * span / most


@given(st.integers(0, 0x9FFFFFFF), st.binary(max_size=64))
def test_no_frame_is_an_error_of_python(identifier, data):
    for wire in WIRES:
        for codec in parse_settings(keys_of(wire), JOINTS, wire).codecs():
            answer = codec.parse(identifier, data)
            assert answer is None or set(answer.values) <= {*codec.quantities(read_only=False), *_ALSO}


_ALSO = {"current", "temperature", "supply_voltage"}


def test_the_example_of_moteus_documentation():
    """docs/protocol/can.md of mjbots/moteus: a command and its answer, byte by byte."""
    command = bytes.fromhex("01000a07206000200150ff140400130d")
    written = list(moteus.subframes(command))
    assert written[:2] == [(0, 0, 0, (10,)), (0, 4, 0x20, (96, 288, -176))]
    assert [(kind, first, count) for kind, _, first, count in written[2:]] == [(0x10, 0, 4), (0x10, 0x0D, 3)]
    (mode, position, velocity, torque), (voltage, temperature, fault) = (
        values for _, _, _, values in moteus.subframes(bytes.fromhex("2404000a005000000170ff230d181400"))
    )
    assert (mode, position, velocity, torque, voltage, temperature, fault) == (10, 80, 256, -144, 24, 20, 0)


def test_keys_that_are_refused():
    motor = {"swing": {"id": 1}, "bend": {"id": 7}}
    wrong = {
        "the same id 1": ("damiao", {"motors": {"swing": {"id": 1}, "bend": {"id": 1}}}),
        "no damiao motor is called 'dm9'": ("damiao", {"model": "dm9"}),
        "'motors.swing.kp' is missing": ("damiao", {"kp": None}),
        "'motors.swing.kd' is missing.*as its controller has them": ("moteus", {"kd": None}),
        "swing: kp 600 is more than its motor allows": ("damiao", {"kp": 600.0}),
        "a damiao motor accepts no torque_limit": (
            "damiao",
            {"motors": motor | {"bend": {"id": 7, "torque_limit": 2.0}}},
        ),
        "when_lost: limp cannot be commanded": ("cubemars", {"when_lost": "limp"}),
        "swing has id 200": ("robstride", {"motors": motor | {"swing": {"id": 200}}}),
    }
    for said, (wire, keys) in wrong.items():
        with pytest.raises(UsageError, match=said):
            parse_settings(keys_of(wire, **keys), JOINTS, wire)


def test_the_budget_counts_goals_readings_and_answers():
    def highest(wire: str, **more: object) -> float:
        budget = declared(wire).budget_of(DriverSettings(JOINTS, keys_of(wire, **more), ()))
        assert budget is not None
        return budget.highest_rate()

    assert highest("damiao", read_only=True) == pytest.approx(1e6 / (2 * 2 * 135))
    assert highest("damiao") == highest("damiao", read_only=True)  # a goal is answered by a reading
    assert highest("cubemars") == pytest.approx(1e6 / (2 * 2 * 135))
    assert highest("robstride") == pytest.approx(1e6 / (2 * 2 * 160))
    readings = 4 * (55 + 135) + 2 * (55 + 135)
    assert highest("odrive") == pytest.approx(1e6 / (2 * 135 + readings))
    assert fd_frame_bits(48, 5.0) < fd_frame_bits(48, 1.0)
    assert math.isclose(fd_frame_bits(8, 1.0), 36 + 9 + 69 + 17 + 6 + 21 + 13)
