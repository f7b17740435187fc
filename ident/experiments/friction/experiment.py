"""Friction experiments: recordings in which one joint moves at a time, at many speeds, warm and cold, in several poses.

As the AUBO paper's §2.2, without taking the joints out of the arm: each joint is swept while the others rest, the sweep
is repeated while the arm warms up, and other poses or weights on the tool change the load torque.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from daq.recording.recording import Recording
from daq.robot.loader import RobotFile
from drivers.core.errors import UsageError
from drivers.core.reading_process import Progress
from drivers.core.software import software_versions
from ident.experiments.friction.joint_data import JointExperiment
from ident.experiments.friction.joint_fit import fit_joint
from ident.experiments.friction.single_joint import JointPeriods, joint_periods
from ident.friction.choice import AUTO, WORDS, check_friction
from ident.friction.table import POSITION_KINDS
from ident.identify.identification import IdentifyChoices
from ident.model.another_arm import check_one_arm
from ident.result.friction_experiment import FrictionExperimentResult
from ident.signals.options import PreprocessChoices


@dataclass(frozen=True)
class FrictionExperiment:
    """Friction of all joints that move alone."""

    result: FrictionExperimentResult  # what friction.json holds
    periods: JointPeriods  # the data
    joints: tuple[JointExperiment, ...]  # in the robot's order


def analyse_friction(
    recordings: Sequence[Recording],
    friction: str = AUTO,
    robot_file: RobotFile | None = None,
    delay: float | None = None,
    progress: Progress = lambda step: None,
) -> FrictionExperiment:
    """Identify the friction of each joint that moves alone, gravity and inertia separately in each period.

    Raises:
        UsageError: no recording, or no such terms.
        DataError: different arms, loops or coupled motors, no joint that moves alone.
        IdentificationError: the movements do not tell the terms apart.
    """
    if not recordings:
        raise UsageError("no recording to identify friction from")
    check_friction(friction)
    if periodic := [word for word in friction.split("+")[1:] if WORDS[word].kinds[0] in POSITION_KINDS]:
        raise UsageError(
            f"the experiment has no term '{periodic[0]}'", where="--friction", hint=f"identify --friction {friction}"
        )
    check_one_arm(recordings)
    robot_file = recordings[0].robot() if robot_file is None else robot_file
    choices = IdentifyChoices(preprocess=PreprocessChoices(delay=delay or 0.0), search_delay=delay is None)
    periods = joint_periods(recordings, robot_file, choices, progress)
    names, section = periods.model.joint_names, robot_file.robot.friction
    joints = []
    for name, own in zip(names, periods.periods, strict=True):
        if own:
            progress(f"friction of {name}")
            joints.append(fit_joint(periods.model, name, own, friction, section))
    labels = [recording.label for recording in recordings]
    result = _result(robot_file.robot.name, labels, friction, periods, joints)
    return FrictionExperiment(result, periods, tuple(joints))


def _result(
    robot: str, recordings: list[str], asked: str, periods: JointPeriods, joints: Sequence[JointExperiment]
) -> FrictionExperimentResult:
    search, moved = periods.data.delay, {joint.stored.joint for joint in joints}
    return FrictionExperimentResult(
        robot=robot,
        recordings=recordings,
        torque_origin=periods.data.runs[0].signals.torque_origin,
        asked=asked,
        delay=periods.data.choices.delay,
        delay_note="as given, not searched" if search is None else search.note,
        joints=[joint.stored for joint in joints],
        friction_steps=[step for joint in joints for step in joint.steps],
        not_moved=[name for name in periods.model.joint_names if name not in moved],
        versions=software_versions(),
    )
