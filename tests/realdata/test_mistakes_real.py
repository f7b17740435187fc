"""A real recording, the UR10's, and deliberate mistakes that its light wrist hides from least squares."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from daq.importers.choices import ImportChoices
from daq.importers.import_file import import_file
from daq.robot.loader import parse_robot
from ident.assessment.file_errors.refit import Refit
from ident.assessment.file_errors.unknowns import Unknown
from ident.assessment.instants import Columns, Instants, instants
from ident.assessment.mistakes.competition import Competition, explanations
from ident.identify.identification import Identification, IdentifyChoices
from ident.identify.identify import identify
from ident.model.regressor import RegressorKernel

pytestmark = [pytest.mark.realdata, pytest.mark.usefixtures("not_simulated")]

JOINTS = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint")
KEPT = (0, 1, 2, 3, 4, 5)
ONES = (1.0,) * 6


@pytest.fixture(scope="module")
def ur10(data_dir: Path) -> Identification:
    limits = "".join(f"  - {{name: {joint}, position: [-6.2832, 6.2832], velocity: 6}}\n" for joint in JOINTS)
    text = f"name: ur10\nmodel:\n  urdf: ur10.urdf\n  gravity: [0, 0, -9.81]\njoints:\n{limits}"
    robot_file = parse_robot(text, where="ur10", folder=data_dir)
    recording = import_file(data_dir / "ur10_unisa1.npz", robot_file, ImportChoices())
    return identify([recording], [], IdentifyChoices(search_delay=False))


@pytest.fixture(scope="module")
def few(ur10: Identification) -> Instants:
    return instants(RegressorKernel(ur10.model, ur10.base.columns), [run.prepared for run in ur10.runs])


def said(ur10: Identification, spoilt: Instants) -> set[tuple[str, tuple[int, ...]]]:
    competition = Competition(ur10.model, ur10.experiment, ur10.base, ur10.solution.active, spoilt)
    return {(one.name, one.joints) for one in explanations(competition, [])}


def test_as_published_nothing_is_said(ur10, few):
    assert said(ur10, few) == set()


def test_all_torques_of_the_opposite_sign_are_said_as_such(ur10, few):
    assert said(ur10, replace(few, torque=-few.torque)) == {("torques-opposite", KEPT)}


def test_a_light_joint_s_sign_is_told_from_friction(ur10, few):
    flipped = few.torque * np.array([1, 1, 1, 1, 1, -1.0])[:, None]
    assert said(ur10, replace(few, torque=flipped)) == {("torque-sign", (5,)), ("position-sign", (5,))}


def test_exchanged_positions_are_told_from_exchanged_torques(ur10, few):
    swapped = few.with_positions(Columns((0, 2, 1, 3, 4, 5), ONES))
    assert said(ur10, swapped) == {("positions-exchanged", (1, 2))}


@pytest.mark.parametrize("degrees", [15.0, 90.0])
def test_gravity_s_direction_comes_with_its_interval(ur10, few, degrees):
    angle = np.deg2rad(degrees)
    believed = replace(ur10.model, gravity=9.81 * np.array([np.sin(angle), 0.0, -np.cos(angle)]))
    found = Refit(believed, ur10.experiment, ur10.base.columns, few, ur10.solution).deviation(Unknown("gravity"))
    assert found is not None
    assert np.rad2deg(found.value) == pytest.approx(degrees, abs=2.0)
