"""What is known of an arm before its excitation is designed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from daq.robot.loader import RobotFile, load_robot, parse_robot
from drivers.core.errors import ResultFileError, UsageError
from ident.excite.prior import find_prior, recording_rate
from ident.identify.identification import Identification, IdentifyChoices, ModelChoices
from ident.identify.identify import identify
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import build_model
from ident.model.true_parameters import truth_vector
from ident.result.result_file import result_json
from ident.result.schema import Result
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording

pytestmark = pytest.mark.usefixtures("estimates_alone")


@pytest.fixture(scope="module")
def identification(three_joint) -> tuple[Identification, Result]:
    motion = random_fourier_motion(build_model(three_joint), 10.0, seed=1)
    recordings = [simulate_recording(three_joint, motion, 20.0, seed=4)]
    found = identify(recordings, [], IdentifyChoices())
    return found, found.result


def written(folder: Path, result: Result) -> Path:
    (folder / "result.json").write_text(result_json(result))
    return folder / "result.json"


def changed(robot_file: RobotFile, old: str, new: str) -> RobotFile:
    assert old in robot_file.text
    return parse_robot(robot_file.text.replace(old, new), where="changed", folder=None)


def test_truth_of_a_simulated_arm(three_joint):
    prior = find_prior(three_joint)
    base = base_parameters(build_model(three_joint))
    assert prior.parameters == pytest.approx(base.projection @ truth_vector(three_joint))
    assert prior.noise.tolist() == [0.8, 0.8, 0.1]
    assert (prior.rate, prior.source) == (200.0, "the robot file's truth")


def test_an_arm_of_which_nothing_is_known(ur_like):
    prior = find_prior(changed(ur_like, "name: j6, position: [-3, 3], velocity: 3, torque: 100", "name: j6, position: [-3, 3], velocity: 3"))  # fmt: skip  # noqa: E501
    assert prior.parameters is None
    assert prior.noise.tolist() == [1.0] * 6  # 1 % of 100 N·m, and 1 N·m where the limit is unknown
    assert "1 % of the torque limit" in prior.source


def test_a_truth_without_noise_says_so(three_joint):
    prior = find_prior(changed(three_joint, "torque_std: {j1: 0.8, j2: 0.8, j3: 0.1}", "torque_std: {j1: 0.8, j2: 0}"))
    assert prior.noise.tolist() == [0.8, 1.0, 0.5]
    assert "no torque noise for j2, j3" in prior.source


def test_result_of_an_identification(three_joint, tmp_path, identification):
    found, result = identification
    prior = find_prior(three_joint, written(tmp_path, result))
    assert prior.parameters == pytest.approx(found.solution.parameters)
    assert find_prior(three_joint, tmp_path).source == prior.source
    filtered = found.runs[0].prepared
    assert prior.rate == pytest.approx(filtered.segments[0].rate / filtered.parallel_filter.factor)
    ratio = np.median(found.std / found.solution.std)
    assert prior.noise == pytest.approx(ratio * found.solution.joint_std)
    # White noise of this size and rate gives the error bars that the identification found, but for its own spread.
    weights = 1.0 / prior.noise
    factor = found.reduction.stacked(weights)[:, : found.base.count]
    expected = np.sqrt(np.diag(np.linalg.inv(factor.T @ factor)))
    assert np.median(found.std / expected) == pytest.approx(1.0, rel=0.02)


def test_a_parameter_that_was_not_excited_counts_as_zero(three_joint, tmp_path, identification):
    result = identification[1]
    parameters = [result.base_parameters[0].model_copy(update={"value": None}), *result.base_parameters[1:]]
    path = written(tmp_path, result.model_copy(update={"base_parameters": parameters}))
    prior = find_prior(three_joint, path)
    assert prior.parameters is not None
    assert prior.parameters[0] == 0.0


def test_other_base_parameters_are_refused(three_joint, tmp_path, identification):
    path = written(tmp_path, identification[1])
    for other in (load_robot("ur5e"), changed(three_joint, "d: 0.4, r: 0.1", "d: 0.5, r: 0.1")):
        with pytest.raises(UsageError, match="other base parameters") as refused:
            find_prior(other, path)
        assert str(path) in str(refused.value)
    motion = random_fourier_motion(build_model(three_joint), 10.0, seed=1)
    recordings = [simulate_recording(three_joint, motion, 12.0, seed=4)]
    choices = IdentifyChoices(model=ModelChoices(friction="viscous"))
    plain = identify(recordings, [], choices).result
    with pytest.raises(UsageError, match="other base parameters"):
        find_prior(three_joint, written(tmp_path, plain))


def test_incomplete_results_are_refused(three_joint, tmp_path, identification):
    result = identification[1]
    residuals = result.residuals.model_copy(update={"joint_std": [0.1, None, 0.1]})
    for changes, words in (
        ({"residuals": residuals}, "residual of a joint"),
        ({"options": {}}, "rate"),
        ({"recordings": []}, "rate"),
    ):
        with pytest.raises(ResultFileError, match=words):
            find_prior(three_joint, written(tmp_path, result.model_copy(update=changes)))
    with pytest.raises(ResultFileError):
        find_prior(three_joint, tmp_path / "missing.json")


def test_recording_rate_is_the_first_connections(three_joint):
    assert recording_rate(three_joint.robot) == 200.0
    assert recording_rate(load_robot("ur5e").robot) == 500.0
    text = "connections:\n  a: {driver: x}\n  b: {driver: x, rate: 125}\n"
    assert recording_rate(parse_robot(three_joint.text + text, where="", folder=None).robot) == 125.0
    text = "connections:\n  a: {driver: x, rate: .nan}\n  b: {driver: x, rate: fast}\n  c: {driver: x, rate: true}\n"
    assert recording_rate(parse_robot(three_joint.text + text, where="", folder=None).robot) == 200.0
