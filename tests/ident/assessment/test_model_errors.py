"""A wrong gain or length is found among the others; a right arm has none."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from daq.recording.recording import JOINTS_STREAM, Recording
from daq.robot.loader import RobotFile
from ident.assessment import instants as few
from ident.assessment.file_errors.model_errors import candidates, model_error_checks, most_likely, quarter_turns
from ident.assessment.file_errors.refit import Refit
from ident.assessment.file_errors.unknowns import Deviation, Unknown, shifted_origins
from ident.assessment.instants import instants
from ident.identify.identification import Identification, IdentifyChoices
from ident.identify.identify import identify
from ident.model.dynamic_model import build_model
from ident.model.regressor import RegressorKernel
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording
from studies.synthetic.data_mistakes import with_values

pytestmark = pytest.mark.usefixtures("not_simulated", "stated_friction")

MODEL_ERRORS = {
    "inconsistent-gain",
    "wrong-gain",
    "other-size",
    "inconsistent-length",
    "joint-zero",
    "gravity-direction",
}


class Arm:
    """One arm, recorded once per seed."""

    def __init__(self, robot_file: RobotFile) -> None:
        self.robot_file = robot_file
        self.recorded = cache(self._recorded)

    def _recorded(self, seed: int) -> Recording:
        motion = random_fourier_motion(build_model(self.robot_file), 10.0, seed, candidates=3)
        return simulate_recording(self.robot_file, motion, 30.0, seed)

    def found(self, seed: int, gain: dict[int, float] | None = None, shift: float = 0.0) -> Identification:
        """Identified with some motor signals scaled, and with d of the third joint off."""
        recording = self.recorded(seed)
        scale = np.array([(gain or {}).get(joint, 1.0) for joint in range(3)])
        current = recording.streams[JOINTS_STREAM].channels["current"].values
        recording = with_values(recording, current=current * scale)
        robot = self.robot_file.robot
        rows = list(robot.model.mdh or ())
        rows[2] = rows[2].model_copy(update={"d": rows[2].d + shift})
        model = robot.model.model_copy(update={"mdh": tuple(rows)})
        robot_file = self.robot_file.model_copy(update={"robot": robot.model_copy(update={"model": model})})
        return identify([recording], [], IdentifyChoices(search_delay=False), robot_file)


@pytest.fixture(scope="module")
def arm(three_joint: RobotFile) -> Arm:
    return Arm(three_joint)


def refit_of(found: Identification) -> Refit:
    prepared = [run.prepared for run in found.runs]
    samples = instants(RegressorKernel(found.model, found.base.columns), prepared)
    return Refit(found.model, found.experiment, found.base.columns, samples, found.solution)


def deviations_of(found: Identification) -> dict[tuple[str, int, int | None], Deviation]:
    ones = refit_of(found).deviations
    return {(one.unknown.kind, one.unknown.joint, one.unknown.axis): one for one in ones}


@pytest.mark.parametrize("seed", [1, 2])
def test_a_right_arm_has_no_deviation(arm, seed):
    found = arm.found(seed)
    assert not MODEL_ERRORS & {check.name for check in found.checks}
    for one in deviations_of(found).values():
        assert abs(one.value) < 4.0 * one.std


@pytest.mark.parametrize(("joint", "gain"), [(1, 0.75), (2, 1.4), (1, 2.0)])
def test_a_wrong_gain_is_named_and_estimated(arm, joint, gain):
    found = arm.found(1, {joint: gain})
    (check,) = [check for check in found.checks if check.name in MODEL_ERRORS]
    assert check.name in ("inconsistent-gain", "wrong-gain")
    estimate = deviations_of(found)["gain", joint, None]
    assert abs(estimate.value - (gain - 1.0)) < 4.0 * estimate.std
    names = found.model.joint_names
    # Joints 2 and 3 share all that they know: which of the two is off the data may not tell.
    assert check.joints[0] in (names[1], names[2])


def test_gains_that_all_differ_are_named_together(arm):
    """Torques in percent of each joint's rated torque have such gains."""
    found = arm.found(1, {0: 7.0, 1: 0.5, 2: 40.0})
    (check,) = [check for check in found.checks if check.name in MODEL_ERRORS]
    assert (check.name, check.joints) == ("wrong-gain", found.model.joint_names)
    gains = refit_of(found).gains()
    ratios = {gains.unknown.joint: 1.0, **{joint: 1.0 + value for joint, value in gains.gains.items()}}
    assert ratios[0] / ratios[1] == pytest.approx(7.0 / 0.5, rel=0.05)
    assert ratios[2] / ratios[1] == pytest.approx(40.0 / 0.5, rel=0.05)
    # A large factor's σ grows with it: 8 ± 2.4 differs from 1 by 7 σ of its logarithm.
    parts = ((Unknown("gain", 1), 1.9, 0.5), (Unknown("gain", 2), 7.0, 2.4))
    uncertain = replace(gains, unknown=Unknown("gains", 0), value=2.9, std=1.0, likelihood=30.0, parts=parts)
    (check,) = model_error_checks(found.model, [uncertain])
    assert (check.name, check.joints) == ("wrong-gain", found.model.joint_names)


def test_a_single_event_is_no_late_position(arm):
    found = arm.found(1)
    refit, late = refit_of(found), Unknown("late", 2)
    recorded, kernel = refit.instants, RegressorKernel(found.model, refit.columns)
    model_torque = np.einsum("nbN,b->nN", recorded.later(2, 0.06).filtered_regressor(kernel), found.solution.parameters)

    def explained(blocks: list[int]) -> bool:
        torque = np.where(np.isin(recorded.block, blocks), model_torque, recorded.torque)
        other = Refit(found.model, found.experiment, refit.columns, replace(recorded, torque=torque), found.solution)
        return other.throughout(other.deviation(late, start=0.05))

    assert explained(list(range(few.BLOCKS)))
    assert not explained([3])


@pytest.fixture(scope="module")
def longer(arm) -> Identification:
    """Identification with a length of the third joint that is 0.05 m more than the arm's."""
    return arm.found(1, shift=0.05)


def test_a_wrong_length_is_named_and_estimated(longer):
    estimate = deviations_of(longer)["length", 2, 0]
    assert abs(estimate.value + 0.05) < 4.0 * estimate.std + 0.01  # linear in 12 % of the length
    (check,) = [check for check in longer.checks if check.name in MODEL_ERRORS]
    assert check.name == "inconsistent-length"
    assert check.joints == ("j3",)


def test_what_explains_the_residuals_to_first_order_alone_is_no_error(longer):
    """Most likely by the linear estimate, it leaves larger residuals than the file, and hid what is wrong."""
    refit, prepared = refit_of(longer), [run.prepared for run in longer.runs]
    right = deviations_of(longer)["length", 2, 0]
    tilt = Unknown("gravity", 0, 0)
    linear = replace(right, unknown=tilt, likelihood=1.1 * right.likelihood, parameters=2.0 * right.parameters)
    named = most_likely(refit, prepared, longer.corrected.effective_rows, [linear, right])
    assert [one.unknown for one in named] == [right.unknown]


def test_a_factor_common_to_all_gains_is_not_seen(arm):
    found = arm.found(1, dict.fromkeys(range(3), 1.3))
    assert not MODEL_ERRORS & {check.name for check in found.checks}


def test_what_the_parameters_take_up_is_left_out(arm):
    found = deviations_of(arm.found(1))
    assert ("length", 0, 2) not in found  # the base's height: no torque depends on it
    assert (0, 2) in shifted_origins(arm.found(1).model)


def test_too_little_data_names_nothing(arm):
    found = arm.found(1, {1: 2.0})
    refit, prepared = refit_of(found), [run.prepared for run in found.runs]
    enough = found.corrected.effective_rows
    assert model_error_checks(found.model, most_likely(refit, prepared, enough, candidates(refit, enough, poor=False)))
    for independent in (0.0, 0.5, 2.0):
        assert most_likely(refit, prepared, independent, candidates(refit, independent, poor=False)) == []


@pytest.mark.parametrize(("degrees", "joint"), [(90.0, 1), (180.0, 1)])
def test_a_zero_off_by_a_quarter_or_half_a_turn_is_named(arm, degrees, joint):
    """Two conventions of one arm differ by such zeros."""
    found = arm.found(1)
    recorded = instants(RegressorKernel(found.model, found.base.columns), [run.prepared for run in found.runs])
    moved = replace(recorded.shifted(joint, np.deg2rad(degrees)), friction=None)
    turns = quarter_turns(Refit(found.model, found.experiment, found.base.columns, moved, found.solution))
    assert any(one.unknown.joint == joint and abs(abs(np.rad2deg(one.value)) - degrees) < 2.0 for one in turns)


def test_long_recordings_are_looked_at_in_part(arm, monkeypatch):
    whole = deviations_of(arm.found(1))["gain", 1, None]
    monkeypatch.setattr(few, "MOST_INSTANTS", 150)
    part = deviations_of(arm.found(1))["gain", 1, None]
    assert part.std > 1.2 * whole.std
    assert abs(part.value) < 4.0 * part.std
