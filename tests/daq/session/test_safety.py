"""The supervisor: nothing inside the limits trips it, anything outside does, and the first breach is named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from each import each
from hypothesis import given
from hypothesis import strategies as st
from kinematic_arm import NAMES, ROBOT_FILE

from daq.session.supervisor import (
    CURES,
    TRACKING_WINDOW,
    VELOCITY_MARGIN,
    Limits,
    Supervisor,
    stale_after,
    value_stale_after,
)
from drivers.streams import Batch, ChannelLayout, StreamLayout

LIMITS = Limits.of_robot(ROBOT_FILE.robot, tracking_error=0.05)
LAYOUTS = (StreamLayout("joints", (ChannelLayout("position", NAMES),), 500.0),)
QUIET = {"position": 0.0, "velocity": 0.0, "torque": 0.0, "temperature": 30.0}
BOUNDS = {"position": 2.0, "velocity": 2.0 * VELOCITY_MARGIN, "torque": 50.0, "temperature": 70.0}


def block(rows: int = 5, start: float = 10.0, **values: np.ndarray) -> Batch:
    time = start + np.arange(rows) * 0.002
    filled = {name: np.full((rows, 2), value) for name, value in QUIET.items()}
    return Batch("joints", time, time + 1000.0, {**filled, **values})


@pytest.mark.parametrize("quantity", BOUNDS)
@given(data=st.data())
def test_a_breach_is_found_exactly_where_it_is(quantity, data):
    bound = BOUNDS[quantity]
    low = -1e3 if quantity == "temperature" else -bound
    row = data.draw(st.integers(0, 4))
    joint = 1 if quantity == "position" else data.draw(st.integers(0, 1))
    values = np.full((5, 2), QUIET[quantity])
    values[row, joint] = data.draw(st.floats(low, bound))
    assert Supervisor(LIMITS, LAYOUTS).check(block(**{quantity: values}), 0.0) is None
    values[row, joint] = data.draw(st.floats(bound, 1e6, exclude_min=True))
    breach = Supervisor(LIMITS, LAYOUTS).check(block(**{quantity: values}), 0.0)
    assert breach is not None
    assert (breach.what, breach.joint, breach.value) == (quantity, NAMES[joint], values[row, joint])
    assert breach.limit == pytest.approx(bound)
    assert breach.time == pytest.approx(10.0 + 0.002 * row)


@each(("quantity", "trips"), [("position", 1), ("velocity", 1), ("torque", 1), ("temperature", 0)])
def test_what_is_not_a_number_is_a_breach_but_for_a_thermometer(quantity, trips):
    breach = Supervisor(LIMITS, LAYOUTS).check(block(**{quantity: np.full((5, 2), np.nan)}), 0.0)
    assert (breach is not None) == bool(trips)
    if breach is not None:
        assert str(breach) == f"{quantity} of shoulder is not a number"
        assert breach.cure == CURES["stuck"]


def test_the_first_breach_in_time_is_told():
    velocity, torque = np.zeros((5, 2)), np.zeros((5, 2))
    velocity[3], torque[1] = 99.0, 99.0
    breach = Supervisor(LIMITS, LAYOUTS).check(block(velocity=velocity, torque=torque), 0.0)
    assert breach is not None
    assert breach.what == "torque"
    assert "torque of shoulder: 99 N·m passes 50 N·m" in str(breach)


def test_an_arm_may_lag_behind_its_commands_but_not_leave_their_path():
    supervisor = Supervisor(LIMITS, LAYOUTS)
    for step in range(400):  # 1 rad/s
        supervisor.commanded(1009.0 + 0.005 * step, np.full(2, 0.005 * step))
    lag = 0.8 * TRACKING_WINDOW  # far more than the allowed error, yet on the path
    assert supervisor.check(block(position=np.full((5, 2), 1.0 - lag)), 0.0) is None
    breach = supervisor.check(block(position=np.full((5, 2), 1.07)), 0.0)
    assert breach is not None
    assert breach.what == "tracking error"
    assert breach.value == pytest.approx(0.07, abs=0.006)


def test_the_controllers_own_target_counts_too():
    breach = Supervisor(LIMITS, LAYOUTS).check(block(target_position=np.full((5, 2), 0.1)), 0.0)
    assert breach is not None
    assert breach.what == "tracking error"


def test_a_silent_stream_is_stale():
    supervisor = Supervisor(LIMITS, LAYOUTS)
    assert supervisor.check_ages(1e6) is None  # it has not begun
    supervisor.check(block(), 50.0)
    assert supervisor.check_ages(50.0 + 0.9 * stale_after(500.0)) is None
    breach = supervisor.check_ages(50.0 + 1.1 * stale_after(500.0))
    assert breach is not None
    assert breach.what == "stale data"
    assert str(breach).endswith("passes 0.05 s")
    asked: list[tuple[str, float]] = []

    def explain(stream: str, limit: float) -> str:
        asked.append((stream, limit))
        return "no answer of the elbow"

    assert str(supervisor.check_ages(51.0, explain)).endswith("passes 0.05 s (no answer of the elbow)")
    assert asked == [("joints", stale_after(500.0))]
    assert stale_after(20.0) == pytest.approx(5 / 20.0)
    assert stale_after(0.0) == np.inf


def thermometer(*columns: str) -> tuple[StreamLayout, ...]:
    layout = StreamLayout("thermometer", (ChannelLayout("temperature", columns),), 5.0, essential=False)
    return (*LAYOUTS, layout)


def heat(*celsius: float) -> Batch:
    return Batch("thermometer", np.zeros(1), np.zeros(1), {"temperature": np.array([celsius])})


@each(
    ("columns", "celsius", "hot"),
    [
        (("elbow",), (71.0,), "elbow"),
        (("shoulder",), (71.0,), "shoulder"),
        (("elbow", "shoulder"), (71.0, 20.0), "elbow"),
        (("elbow", "shoulder"), (20.0, 71.0), "shoulder"),
        (("room", "elbow", "gearbox"), (99.0, 71.0, 99.0), "elbow"),
        (("room", "elbow", "gearbox"), (99.0, np.nan, 99.0), None),
        (("room",), (99.0,), None),
        (("first", "second"), (20.0, 71.0), "elbow"),  # as many as joints, without their names
    ],
)
def test_a_limit_holds_for_the_column_with_the_joints_name(columns, celsius, hot):
    breach = Supervisor(LIMITS, thermometer(*columns)).check(heat(*celsius), 0.0)
    assert (breach.joint if breach else None) == hot
    assert breach is None or (breach.value, breach.limit) == (71.0, 70.0)


@given(st.permutations(NAMES), st.floats(-5, 5), st.floats(-5, 5))
def test_the_order_of_columns_changes_nothing(order, shoulder, elbow):
    values = {"shoulder": shoulder, "elbow": elbow}
    layouts = (StreamLayout("joints", (ChannelLayout("position", tuple(order)),), 500.0),)
    sorted_block = Batch("joints", np.zeros(1), np.zeros(1), {"position": np.array([[shoulder, elbow]])})
    mixed_block = Batch("joints", np.zeros(1), np.zeros(1), {"position": np.array([[values[name] for name in order]])})
    sorted_one, mixed_one = Supervisor(LIMITS, LAYOUTS), Supervisor(LIMITS, layouts)
    for supervisor in (sorted_one, mixed_one):
        supervisor.commanded(0.0, np.array([shoulder, elbow]))  # as commanded: no tracking error
    assert sorted_one.check(sorted_block, 0.0) == mixed_one.check(mixed_block, 0.0)


def test_a_stream_that_is_not_essential_may_fall_silent_where_nothing_in_it_has_a_limit():
    supervisor = Supervisor(LIMITS, thermometer("room"))
    supervisor.check(heat(20.0), 50.0)
    assert supervisor.check_ages(1e6) is None
    unlimited = replace(LIMITS, temperature=np.array([70.0, np.inf]))
    supervisor = Supervisor(unlimited, thermometer("elbow"))
    supervisor.check(heat(20.0), 50.0)
    assert supervisor.check_ages(1e6) is None


@pytest.mark.parametrize("then", [None, np.nan])
def test_a_temperature_with_a_limit_that_stops_arriving_is_a_breach(then):
    supervisor = Supervisor(LIMITS, thermometer("shoulder", "elbow"))
    allowed = value_stale_after("temperature", 5.0)
    assert supervisor.check_ages(1e6) is None  # it has not begun
    for second in range(60):
        supervisor.check(heat(20.0, 30.0 if second < 30 or then is None else then), float(second))
        assert (supervisor.check_ages(float(second)) is None) == (then is None or second <= 29 + allowed)
        if second > 29 + allowed and then is not None:
            break
    if then is None:
        breach = supervisor.check_ages(59.0 + 1.01 * allowed)
        assert breach is not None
        assert breach.joint == "temperature of shoulder, elbow"
    else:
        breach = supervisor.check_ages(float(second))
        assert breach is not None
        assert breach.joint == "temperature of elbow"
    assert str(breach).startswith(f"stale data of {breach.joint}: ")
    supervisor.restart_ages(100.0)
    assert supervisor.check_ages(100.0 + 0.9 * allowed) is None
    assert supervisor.check_ages(100.0 + 1.1 * allowed) is not None


def test_a_quantity_that_arrives_in_another_stream_is_not_stale():
    layouts = (StreamLayout("joints", (ChannelLayout("temperature", NAMES),), 500.0), *thermometer("elbow")[1:])
    supervisor = Supervisor(LIMITS, layouts)
    supervisor.check(heat(20.0), 0.0)
    for second in range(100):
        supervisor.check(Batch("joints", np.zeros(1), np.zeros(1), {"temperature": np.full((1, 2), 30.0)}), second)
        assert supervisor.check_ages(second) is None


def test_values_of_unknown_rate_are_waited_for_longer():
    assert value_stale_after("temperature", 0.0) == 60.0
    assert value_stale_after("torque", 0.0) == 1.0
    assert value_stale_after("torque", 500.0) == stale_after(500.0)
    assert value_stale_after("temperature", 0.5) == 10.0
