"""Friction and torque over the position: chosen by runs left out, predicted, stored, simulated and exported."""

from __future__ import annotations

import numpy as np
import pytest
from friction_experiment_arm import TWO_BODIES

from daq.recording.recording import JOINTS_STREAM, Recording
from daq.robot.loader import RobotFile, parse_robot
from drivers.core.errors import DataError
from ident.export.c_code.expressions import Graph
from ident.export.c_code.functions import arm_functions
from ident.identify.identification import Identification, IdentifyChoices, ModelChoices
from ident.identify.identify import identify
from ident.model.dynamics.inverse_dynamics import InverseDynamics
from ident.model.true_parameters import true_model
from ident.result.models.model import Model
from ident.result.result_file import result_json
from ident.result.schema import Result
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording
from studies.synthetic.data_mistakes import with_values

pytestmark = pytest.mark.usefixtures("estimates_alone")

ARM = (
    TWO_BODIES
    + """  joints:
    j1: {viscous: 5, coulomb: 4, offset: 0.3, motor_inertia: 0.6}
    j2: {viscous: 3, coulomb: 3, offset: -0.2, motor_inertia: 0.3}
  noise:
    rate: 100
    torque_std: {j1: 0.1, j2: 0.1}
"""
)
CHOICES = IdentifyChoices(model=ModelChoices(friction="auto"), search_delay=False, presliding=False)


def recorded(seed: int, motion: int, size: float = 0.0) -> Recording:
    """A run with a torque of three periods per turn on j1, and a friction of one on j2 [N·m]."""
    robot_file: RobotFile = parse_robot(ARM, where="arm", folder=None)
    run = simulate_recording(robot_file, random_fourier_motion(true_model(robot_file), 8.0, motion), 8.0, seed)
    stream = run.streams[JOINTS_STREAM]
    position = stream.channels["position"].values
    added = size * np.column_stack(
        [np.cos(3.0 * position[:, 0]), np.sign(np.gradient(position[:, 1])) * np.sin(position[:, 1])]
    )
    gains = [robot_file.robot.drive(joint).gain for joint in robot_file.robot.joint_names]
    return with_values(run, current=stream.channels["current"].values + added / gains)


def chosen(found: Identification) -> list[tuple[str, str]]:
    return [(step.joint, step.term) for step in found.friction.steps if step.accepted]


@pytest.fixture(scope="module")
def rippled() -> tuple[Identification, Result]:
    runs = [recorded(seed, seed, 0.8) for seed in (1, 2, 3)], [recorded(4, 4, 0.8)]
    found = identify(*runs, CHOICES)
    return found, found.result


def test_three_motions_tell_what_repeats_over_a_turn(rippled):
    found, result = rippled
    assert chosen(found) == [("j1", "ripple-3"), ("j2", "position-1")]
    assert found.validation.relative_error < 0.02
    values = dict(zip(found.base.names, zip(found.solution.parameters, found.std, strict=True), strict=True))
    for name, truth in (("Rc1", 0.8), ("Rs1", 0.0), ("Fpc2", 0.0), ("Fps2", 0.8)):
        value, std = values[name]
        assert abs(value - truth) < 4.0 * std, values
        assert std < 0.1, values
    assert [step.name for step in result.preprocessing if step.name.startswith("friction")]


def test_fewer_motions_and_arms_without_have_no_such_terms():
    for runs in (
        [recorded(seed, seed, 0.8) for seed in (1, 2)],
        [recorded(seed, 1, 0.8) for seed in (1, 2, 3)],
        [recorded(seed, seed) for seed in (1, 2, 3)],
    ):
        found = identify(runs, [recorded(4, 4)], CHOICES)
        assert not any(found.model.needs("position")), chosen(found)


def test_it_is_carried_through_everything(rippled, tmp_path):
    _, stored = rippled
    model = Model(Result.model_validate_json(result_json(stored)))
    q, dq, ddq = np.array([0.4, 0.3]), np.array([0.5, -0.4]), np.array([0.1, 0.2])
    torque = model.torque(q, dq, ddq)
    with pytest.raises(DataError, match="positions are missing"):
        model.friction(dq)
    parts = model.mass_matrix(q) @ ddq + model.gravity(q) + model.coriolis(q, dq) + model.friction(dq, q)
    assert np.allclose(parts, torque)
    assert np.allclose(model.forward_dynamics(q, dq, torque), ddq)
    assert abs(model.friction(dq, q)[0] - model.friction(dq, q + np.pi / 3.0)[0]) > 0.5

    def controller(time, at, rate):
        return model.torque(at, dq, [0.0, 0.0])

    assert np.allclose(model.simulate(q, dq, controller, 0.3).velocity[-1], dq, atol=2e-3)
    lacking = " ".join(model.export_urdf(tmp_path / "arm.urdf").left_out)
    assert "torque ripple of j1" in lacking
    assert "friction by position of j2" in lacking
    assert "1 per turn" in stored.friction[1].terms_text


def test_c_code_has_it(rippled):
    found, _ = rippled
    dynamics = InverseDynamics(found.model, found.base, found.solution.parameters)
    graph = Graph()
    functions = {function.name: function for function in arm_functions(graph, dynamics)}
    assert functions["friction"].inputs == ("q", "dq")
    q, dq = np.array([[0.4], [0.3]]), np.array([[0.5], [-0.4]])
    given = {f"{name}{joint}": signal[joint] for name, signal in (("q", q), ("dq", dq)) for joint in range(2)}
    written = graph.evaluate(functions["friction"].outputs, given)
    assert np.allclose(written, dynamics.friction(dq, q), rtol=1e-12)
