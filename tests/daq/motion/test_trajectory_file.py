"""The trajectory file: every kind is read, moves from rest to rest, and what is wrong is named."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
import yaml
from each import each
from hypothesis import given, settings
from hypothesis import strategies as st
from kinematic_arm import ROBOT_FILE

from daq.motion.limits import check_limits
from daq.motion.trajectory_file import dump_trajectory, load_trajectory, parse_trajectory
from drivers.core.errors import UsageError

ROBOT = ROBOT_FILE.robot
FOURIER = {
    "robot": "two-links",
    "kind": "fourier",
    "period": 5.0,
    "offset": [0.0, 0.1],
    "sine": [[0.3, 0.1], [0.2, -0.1]],
    "cosine": [[0.1, 0.0], [0.0, 0.1]],
    "periods": 2,
}
QUINTIC = {
    "robot": "two-links",
    "kind": "fourier-quintic",
    "period": 5.0,
    "offset": [0.0, 0.1],
    "sine": [[0.3, 0.1], [0.2, -0.1]],
    "cosine": [[0.1, 0.0], [0.0, 0.1]],
    "periods": 3,
}
SINES = {
    "robot": "two-links",
    "kind": "sines",
    "duration": 4.0,
    "offset": [0.0, 0.0],
    "amplitude": [[0.2, 0.1], [0.3, 0.1]],
    "frequency": [[1.0, 2.5], [1.3, 3.1]],
}
POINTS = {"robot": "two-links", "kind": "points", "points": [[0, 0], [1, 1], [0, 0]], "durations": [2, 2], "dwell": 0.5}
SAMPLES = {
    "robot": "two-links",
    "kind": "samples",
    "time": [0, 1, 2, 3],
    "position": [[0, 0], [0.1, 0.1], [0.1, 0.2], [0, 0]],
}


def parse(content):
    return parse_trajectory(yaml.safe_dump(content), ROBOT, where="traj.yaml", folder=None)


@each("content", [FOURIER, QUINTIC, SINES, POINTS, SAMPLES])
def test_every_kind_moves_from_rest_to_rest_and_survives_its_text(content):
    read = parse(content)
    ends = np.array([0.0, read.motion.duration])
    _, velocity, acceleration = read.motion.evaluate(ends)
    assert np.allclose(velocity, 0.0, atol=1e-9)
    again = parse_trajectory(dump_trajectory(read.trajectory), ROBOT, where="again", folder=None)
    time = np.linspace(0.0, read.motion.duration, 200)
    for one, other in zip(read.motion.evaluate(time), again.motion.evaluate(time), strict=True):
        np.testing.assert_array_equal(one, other)
    if content["kind"] != "samples":  # a spline is at rest at its ends, but begins with a jump of acceleration
        assert np.allclose(acceleration, 0.0, atol=1e-9)


@each(
    ("content", "expected"),
    [
        ({**FOURIER, "robot": "ur5e"}, "made for 'ur5e'"),
        ({**FOURIER, "kind": "spline"}, "allowed: fourier, fourier-quintic, sines, points, samples"),
        ({"robot": "two-links"}, "kind: this key is missing"),
        ({**FOURIER, "perod": 1}, "period"),
        ({**FOURIER, "period": -1}, "period: found -1"),
        ({**FOURIER, "cosine": [[0.1], [0.2]]}, "'cosine' is 2 × 1, but 'sine' is 2 × 2"),
        ({**FOURIER, "sine": [[0.1, 0.2], [0.2]]}, "rows of different length: 1, 2"),
        ({**FOURIER, "offset": [0.0]}, "'offset' has 1 joints"),
        ({**FOURIER, "offset": [0.0, 2.5]}, "joint elbow: position"),
        ({**FOURIER, "sine": [[3.0, 0.1], [0.2, -0.1]]}, "joint shoulder: velocity"),
        ({**QUINTIC, "offset": [0.0]}, "'offset' has 1 joints"),
        ({**QUINTIC, "cosine": [[0.1], [0.2]]}, "'cosine' is 2 × 1, but 'sine' is 2 × 2"),
        ({**QUINTIC, "ramp": 2.0}, "ramp: unknown key"),
        ({**FOURIER, "ramp": 0.05}, "ramp: found 0.05, but it should be greater than or equal to 0.1"),
        ({**SINES, "ramp": 1e-3}, "ramp: found 0.001"),
        ({**QUINTIC, "periods": 0}, "periods: found 0"),
        ({**QUINTIC, "period": 50_000.0}, "lasts 150000 s"),
        ({**QUINTIC, "cosine": [[0.1, 0.0], [9.0, 0.1]]}, "joint elbow: position"),
        ({**POINTS, "durations": [2]}, "3 points need 2 durations, not 1"),
        ({**POINTS, "points": [[0, 0, 0], [1, 1, 1], [0, 0, 0]]}, "moves 3 joints, but the robot has 2"),
        ({**SAMPLES, "time": [0, 1, 1, 2]}, "does not increase at sample 2"),
        ({**SINES, "frequency": [[float("nan"), 1], [1, 1]]}, "finite"),
    ],
)
def test_what_is_wrong_is_named(content, expected):
    with pytest.raises(UsageError) as caught:
        parse(content)
    assert expected in str(caught.value)
    assert "traj.yaml" in caught.value.where


def test_samples_of_a_csv_file_stand_in_the_text(tmp_path):
    (tmp_path / "path.csv").write_text("elbow,time,shoulder\n0,10,0\n0.1,11,0.2\n0.2,12,0.3\n0,13,0\n")
    (tmp_path / "t.yaml").write_text("robot: two-links\nkind: samples\ncsv: path.csv\n")
    read = load_trajectory(tmp_path / "t.yaml", ROBOT)
    position, _, _ = read.motion.evaluate(np.array([0.0, 1.0, 2.0, 3.0]))
    np.testing.assert_allclose(position, [[0, 0.2, 0.3, 0], [0, 0.1, 0.2, 0]], atol=1e-12)
    (tmp_path / "path.csv").unlink()
    parse_trajectory(read.text, ROBOT, where="recording", folder=None)  # needs the CSV no more
    with pytest.raises(UsageError, match="no such file"):
        load_trajectory(tmp_path / "t.yaml", ROBOT)
    (tmp_path / "path.csv").write_text("time,shoulder\n0,0\n")
    with pytest.raises(UsageError, match="has no column elbow"):
        load_trajectory(tmp_path / "t.yaml", ROBOT)
    (tmp_path / "path.csv").write_text("time,shoulder,elbow\n0,0,0\n1,x,0\n")
    with pytest.raises(UsageError, match="line 3"):
        load_trajectory(tmp_path / "t.yaml", ROBOT)


@given(st.text(max_size=80))
def test_any_text_is_read_or_refused_in_words(text):
    with pytest.raises(UsageError):
        parse_trajectory(text, ROBOT, where="traj.yaml", folder=None)


NUMBERS = st.floats(allow_nan=True, allow_infinity=True) | st.floats(-2.0, 2.0) | st.integers() | st.text(max_size=3)
HOSTILE = {
    "period": NUMBERS | st.none(),
    "offset": st.lists(NUMBERS, max_size=3),
    "sine": st.lists(st.lists(NUMBERS, max_size=2), max_size=3) | NUMBERS,
    "cosine": st.lists(st.lists(NUMBERS, max_size=2), max_size=3) | st.none(),
    "periods": NUMBERS | st.booleans(),
    "robot": st.just("two-links") | st.text(max_size=3),
    "comment": st.text(max_size=3) | st.integers(),
}


@settings(max_examples=100, deadline=None)
@given(st.fixed_dictionaries({}, optional=HOSTILE))
def test_a_series_of_any_values_is_within_the_limits_or_refused_in_words(values):
    try:
        read = parse({**QUINTIC, **values})
    except UsageError:
        return
    check_limits(read.motion, ROBOT.joints, "played")
    position, velocity, acceleration = read.motion.evaluate(np.array([0.0, read.motion.duration]))
    np.testing.assert_allclose(position[:, 0], position[:, 1], atol=1e-9)
    assert np.abs(velocity).max() < 1e-3 * min(limit.velocity for limit in ROBOT.joints)
    assert np.all(np.isfinite(acceleration))


EXTREME = st.sampled_from([0.0, 1e-300, 1e-160, 1e-9, 1e9, 1e160, 1e300, 1.7e308, -1e-300, -1e300])


def with_extremes(data, value):
    """The value with some of its numbers replaced."""
    if isinstance(value, list):
        return [with_extremes(data, part) for part in value]
    if isinstance(value, float | int) and data.draw(st.integers(0, 3)) == 0:
        return data.draw(EXTREME)
    return value


@settings(max_examples=75, deadline=None)
@given(st.sampled_from([FOURIER, QUINTIC, SINES, POINTS, SAMPLES]), st.data())
def test_extreme_numbers_are_refused_in_words_and_without_warnings(content, data):
    changed = {key: with_extremes(data, value) for key, value in content.items()}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            read = parse(changed)
        except UsageError:
            return
    check_limits(read.motion, ROBOT.joints, "played")


def test_a_series_of_too_many_harmonics_is_refused_before_it_is_evaluated() -> None:
    rows = f"[{', '.join(['0'] * 1001)}]"
    text = (
        "robot: two-links\nkind: fourier\nperiod: 10\noffset: [0, 0]\n"
        f"sine: [{rows}, {rows}]\ncosine: [{rows}, {rows}]\n"
    )
    with pytest.raises(UsageError, match="at most 1000"):
        parse_trajectory(text, ROBOT, where="t.yaml", folder=None)


@each(
    ("content", "said"),
    [
        ({**POINTS, "durations": [1e-12] * len(POINTS["durations"])}, "is not within 0.001 to 86400 s"),
        ({**SINES, "duration": 1e-4}, "is not within 0.001 to 86400 s"),
        (
            {**SAMPLES, "time": [17005.0 + t for t in (0.0, 1.0, 1.0 + 1e-11, 2.0)], "position": [[0.1, 0.1]] * 4},
            "samples 1 and 2 are 1.09e-11 s apart; allowed: 0.0001 to 86400 s",
        ),
    ],
)
def test_a_piece_of_almost_no_duration_is_refused(content, said):
    """At 17,005 s floating point tells times of 4e-12 s apart: a move of 1e-12 s there would be a step."""
    with pytest.raises(UsageError) as error:
        parse(content)
    assert said in str(error.value)
