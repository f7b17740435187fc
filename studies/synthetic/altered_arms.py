"""Simulated arms that differ from their robot files: other drive gains, other servos, another unit of the same type."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from daq.robot.loader import RobotFile
from daq.robot.schema import Truth, TruthJoint, TruthSupply
from drivers.core.errors import RobotFileError
from sim_drivers.plant.servo import true_servos


def with_gains(robot_file: RobotFile, factors: Mapping[str, float]) -> RobotFile:
    """The arm whose true drive gains are those of the file times `factors` (joint → factor; 1 where none is given)."""
    robot = robot_file.robot
    for name in factors:
        if name not in robot.joint_names:
            raise RobotFileError(f"no joint is called '{name}'", where=robot.name)
    drives = tuple(
        drive if drive.gain is None else drive.model_copy(update={"gain": drive.gain * factors.get(drive.joint, 1.0)})
        for drive in robot.drives
    )
    return robot_file.model_copy(update={"robot": robot.model_copy(update={"drives": drives})})


def with_servos(
    robot_file: RobotFile, supply: TruthSupply | None = None, joint: Mapping[str, float] | None = None, **servo: float
) -> RobotFile:
    """The arm with other truths of all its servos: fields of `TruthServo`, and of `TruthJoint` in `joint`.

    Args:
        robot_file: its truth has a servo for every joint.
        supply: of all servos; that of the file where None.
        joint: fields of every joint, such as `stribeck`.
        servo: fields of every servo, such as `backlash`.
    """
    truth = robot_file.robot.truth
    joints = {
        name: joint_truth
        if joint_truth.servo is None
        else TruthJoint.model_validate(
            {
                **joint_truth.model_dump(exclude={"servo"}),
                **(joint or {}),
                "servo": {**joint_truth.servo.model_dump(), **servo},
            }
        )
        for name, joint_truth in truth.joints.items()
    }
    return _with_truth(robot_file, truth.model_copy(update={"joints": joints, "supply": supply or truth.supply}))


UNIT_DIFFERENCES = ("stiffness", "torque_limit", "load_friction", "gain_d")
"""Fields of a servo that differ from one unit of a type to the next; and, of its joint: motor inertia and friction."""


def another_unit(robot_file: RobotFile, spread: float, seed: int) -> RobotFile:
    """Another unit of the same type of servo arm: gains, inertias and friction differ by a factor each.

    Args:
        robot_file: its truth has a servo for every joint.
        spread: standard deviation of the factors' logarithms.
        seed: of the factors.
    """
    generator = np.random.default_rng(seed)
    truth = robot_file.robot.truth
    joints = {}
    for name, joint_truth in truth.joints.items():
        factors = np.exp(spread * generator.standard_normal(len(UNIT_DIFFERENCES) + 3)).tolist()
        servo = joint_truth.servo and joint_truth.servo.model_copy(
            update={
                field: getattr(joint_truth.servo, field) * factor
                for field, factor in zip(UNIT_DIFFERENCES, factors, strict=False)
            }
        )
        own = ("motor_inertia", "viscous", "coulomb")
        update = {field: getattr(joint_truth, field) * factor for field, factor in zip(own, factors[-3:], strict=True)}
        joints[name] = joint_truth.model_copy(update={**update, "servo": servo})
    return _with_truth(robot_file, truth.model_copy(update={"joints": joints}))


def true_values(file: RobotFile) -> dict[str, dict[str, float]]:
    """True parameters of `ident.servo.terms` per joint, in a cold arm at the supply's voltage without load.

    Backlash, steps of the loop's encoder and jitter have no such parameter: of jitter, the mean delay is in `delay`.

    Args:
        file: its truth has a servo for every joint.
    """
    truth, supply = file.robot.truth, file.robot.truth.supply
    values = {}
    servos = true_servos(file.robot, file.where)
    for name, servo in zip(file.robot.joint_names, servos, strict=True):
        joint = truth.joints[name]
        fast = servo.no_load_speed
        share = supply.voltage / supply.nominal if supply is not None and fast is not None else 1.0
        back = 0.0 if fast is None else servo.torque_limit / fast
        values[name] = {
            "stiffness": share * servo.stiffness,
            "damping": joint.viscous + servo.gain_d + back,
            "armature": joint.motor_inertia,
            "coulomb": joint.coulomb,
            "bias": servo.bias,
            "delay": servo.delay + servo.jitter / 2,
            "acceleration_limit": servo.acceleration,
            "load_friction": servo.load_friction,
            "breakaway": joint.stribeck,
            "stribeck_velocity": joint.stribeck_velocity,
            "torque_limit": share * servo.torque_limit,
            "dead_band": servo.dead_band,
        }
    return values


def _with_truth(robot_file: RobotFile, truth: Truth) -> RobotFile:
    return robot_file.model_copy(update={"robot": robot_file.robot.model_copy(update={"truth": truth})})
