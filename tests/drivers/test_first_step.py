from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from drivers.core.errors import DriverStateError
from drivers.first_step import FIRST_STEP_LIMIT, check_first_step, finite_position

JOINTS = ("shoulder", "elbow", "wrist")
POSITION = arrays(np.float64, 3, elements=st.floats(-7, 7) | st.sampled_from([np.nan, np.inf, -np.inf]))


@given(POSITION, POSITION)
def test_only_a_near_and_finite_position_passes(target: np.ndarray, measured: np.ndarray) -> None:
    near = [
        np.isfinite(t) and np.isfinite(m) and abs(t - m) <= FIRST_STEP_LIMIT
        for t, m in zip(target, measured, strict=True)
    ]
    if all(near):
        check_first_step(target, measured, JOINTS)
        return
    with pytest.raises(DriverStateError) as caught:
        check_first_step(target, measured, JOINTS)
    assert not near[JOINTS.index(caught.value.where.removeprefix("joint "))]


@given(POSITION)
def test_a_commanded_position_is_n_finite_numbers(position: np.ndarray) -> None:
    if np.all(np.isfinite(position)):
        assert np.array_equal(finite_position(list(position), JOINTS), position)  # type: ignore[arg-type]
        return
    with pytest.raises(ValueError, match="3 finite numbers"):
        finite_position(position, JOINTS)


def test_the_joint_that_is_worst_is_named() -> None:
    with pytest.raises(DriverStateError, match=r"0\.300 rad away") as caught:
        check_first_step(np.array([0.2, -0.3, 0.0]), np.zeros(3), JOINTS)
    assert caught.value.where == "joint elbow"
    with pytest.raises(DriverStateError, match=r"0\.300 m away") as caught:
        check_first_step(np.array([0.2, -0.3, 0.0]), np.zeros(3), JOINTS, (False, True, False))
    assert caught.value.hint == "begin within 0.1 m of the measured position"
    with pytest.raises(DriverStateError, match="measured one, nan") as caught:
        check_first_step(np.array([0.2, 0.0, 0.0]), np.array([0.0, 0.0, np.nan]), JOINTS)
    assert caught.value.where == "joint wrist"
    with pytest.raises(DriverStateError, match="no position of the arm is known"):
        check_first_step(np.zeros(3), None, JOINTS)
