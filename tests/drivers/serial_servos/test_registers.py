"""Register tables and joint maps: units, signs, and what calibration files say."""

from __future__ import annotations

import json
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.core.errors import UsageError
from drivers.serial_servos.registers import Register, known_models, servo_table
from drivers.serial_servos.settings import parse_settings, read_calibration, scale_of

SIGNS = st.sampled_from(["none", "two's complement", 10, 11, 15])


@given(sign=SIGNS, big=st.booleans(), share=st.floats(0, 1))
def test_counts_survive_their_bytes(sign, big, share):
    entry = Register("any", 0, 2, sign=sign, big_endian=big)
    least, most = entry.bounds
    counts = round(least + share * (most - least))
    assert entry.decoded(entry.encoded(counts)) == counts
    for beyond in (least - 1, most + 1):
        with pytest.raises(ValueError, match="is not within"):
            entry.encoded(beyond)


def test_every_table_has_what_the_driver_needs():
    needed = {
        *("model_number", "id", "min_position", "max_position", "return_delay", "torque_enable", "goal_position"),
        *("status", "present_position", "present_voltage", "present_temperature", "max_voltage", "min_voltage"),
    }
    lacking = {}
    numbers = set()
    for model in known_models():
        table = servo_table(model)
        numbers.add(table.number)
        places = sorted((entry.address, entry.address + entry.size) for entry in table.registers.values())
        apart = all(end <= start for (_, end), (start, _) in pairwise(places))
        missing = needed - set(table.registers) | set(table.feedback.values()) - set(table.registers)
        writable = {name for name in ("torque_enable", "goal_position") if table.registers[name].eeprom}
        if missing or not apart or writable or table.block[1] > 64 or not table.documents["registers"]:
            lacking[model] = missing, apart, writable, table.block
    assert lacking == {}
    assert len(numbers) == len(known_models())
    with pytest.raises(UsageError, match="no servo model is called 'sts3216'") as refused:
        servo_table("sts3216")
    assert "sts3215" in refused.value.hint


def test_units_and_signs_of_the_documents():
    sts, xl330, xm430 = (servo_table(model).registers for model in ("sts3215", "xl330-m288", "xm430-w350"))
    assert sts["present_position"].decoded(b"\x00\x80") == 0
    assert sts["present_velocity"].decoded(b"\x0a\x80") == -10
    assert sts["present_load"].decoded(b"\x64\x04") == -100  # bit 10
    assert sts["homing_offset"].decoded(b"\x01\x08") == -1  # bit 11
    assert sts["present_current"].decoded(b"\x01\x80") * sts["present_current"].scale == pytest.approx(32769 * 0.0065)
    assert xl330["present_current"].decoded(b"\xff\xff") * xl330["present_current"].scale == pytest.approx(-0.001)
    assert xm430["present_current"].scale == pytest.approx(0.00269)
    assert xl330["present_velocity"].scale == pytest.approx(0.229 * 2 * np.pi / 60)
    assert sts["acceleration"].scale == pytest.approx(100 * 2 * np.pi / 4096)
    assert servo_table("scs0009").registers["present_position"].decoded(b"\x02\x01") == 0x0201


@given(zero=st.floats(0, 4096), direction=st.sampled_from([1, -1]), steps=st.integers(0, 4095))
def test_steps_survive_the_joint(zero, direction, steps):
    scale = scale_of(4096, zero=zero, direction=direction)
    assert scale.steps(scale.position(steps)) == steps


CALIBRATION = {
    "swing": {"id": 1, "drive_mode": 0, "homing_offset": -100, "range_min": 1000, "range_max": 3000},
    "bend": {"id": 7, "drive_mode": 1, "homing_offset": 5, "range_min": 2000, "range_max": 3500},
}
KEYS = {"url": "none", "model": "sts3215", "motors": {"swing": {"id": 1}, "bend": {"id": 7, "at_lowest": -0.2}}}


def test_a_calibration_is_the_joint_map(tmp_path):
    (tmp_path / "arm.json").write_text(json.dumps(CALIBRATION))
    settings = parse_settings({**KEYS, "calibration": "arm.json"}, ("swing", "bend"), tmp_path)
    swing, bend = (motor.scale for motor in settings.motors)
    assert swing.position(2000) == 0.0
    assert swing.position(3000) == pytest.approx(1000 * 2 * np.pi / 4096)
    assert bend.direction == -1
    assert bend.position(2000) == pytest.approx(-0.2)
    assert not any(motor.assumed_zero for motor in settings.motors)
    other = {**KEYS, "motors": {"swing": {"id": 2}, "bend": {"id": 7}}, "calibration": "arm.json"}
    with pytest.raises(UsageError, match=r"swing has id 2 here, and 1 in arm\.json"):
        parse_settings(other, ("swing", "bend"), tmp_path)


WRONG_FILES = {
    "[]": "is not a calibration",
    "{": "is not JSON",
    '{"swing": {"id": 1}}': "needs the integers",
    '{"swing": {"id": 1, "drive_mode": 2, "homing_offset": 0, "range_min": 0, "range_max": 9}}': "cannot be",
    '{"swing": {"id": 1, "drive_mode": 0, "homing_offset": 0, "range_min": 9, "range_max": 9}}': "cannot be",
}


def test_files_that_are_no_calibration(tmp_path):
    path = tmp_path / "arm.json"
    for text, said in WRONG_FILES.items():
        path.write_text(text)
        with pytest.raises(UsageError, match=said):
            read_calibration(path)


WRONG_KEYS = {
    "is not a joint": {"motors": {**KEYS["motors"], "wrist": {"id": 3}}},
    "no motor for": {"motors": {"swing": {"id": 1}}},
    "have the same id 1": {"motors": {"swing": {"id": 1}, "bend": {"id": 1}}},
    "no servo model is called": {"model": "sts9"},
    "model' is missing": {"model": None},
    "is no feetech servo": {"model": "xl430-w250"},
    "from 0 to 252": {"motors": {"swing": {"id": 300}, "bend": {"id": 7}}},
    "hold or limp": {"on_stop": "fall"},
    "from 0.01 to 1": {"torque_limit": 2.0},
}


def test_keys_that_cannot_be():
    for said, keys in WRONG_KEYS.items():
        with pytest.raises(UsageError) as refused:
            parse_settings({**KEYS, **keys}, ("swing", "bend"))
        assert said in f"{refused.value}", said
