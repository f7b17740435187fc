"""Identifiable parameters by experiment: locked joints, motors whose torques are used (SR400 .4.3 point 7).

With joints locked, or with the rows of some motors only, fewer combinations of the standard parameters act than in free
motion. Which ones follows from the model: the regressor at random states with the locked joints where they were, and
only the chosen motors' rows. So the regrouping does not hang on how well a recording happens to be excited.

The torque of a motor that never turns is left out unless requested: static friction, or a brake, holds an unknown
share of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.errors import DataError, IdentificationError, UsageError
from drivers.core.units import common_unit
from ident.linear_algebra.triangular import QrAccumulator
from ident.model.base_parameters import (
    STATES_PER_PARAMETER,
    BaseParameters,
    ModelKey,
    base_parameters,
    base_parameters_of,
    random_states,
    random_temperature,
)
from ident.model.dynamic_model import DynamicModel
from ident.model.regressor import RegressorKernel, evaluate_in_chunks
from ident.regression.options import REST_TOLERANCE, ExperimentChoices

LARGEST_REST_TOLERANCE = 0.1
"""A joint that moves farther [rad or m] is not at rest by any standard."""

NOISE_DEVIATIONS = 10.0
"""… or within so many standard deviations of its encoder's noise: the range of a million normal values."""

SAME_POSE = 0.01
"""Positions of a locked joint closer than this [rad or m] are the same."""

RIGHT_ANGLE = 2e-3
"""A joint locked so near [rad] to a multiple of 90° counts as being there: geometry is special there, and parameters
that only this small angle separates are confounded with an error of the angle."""


@dataclass(frozen=True)
class Experiment:
    """Conditions of a set of recordings: locked joints and used torques."""

    locked: tuple[int, ...]  # indices of the joints with a motor that rested throughout
    # their positions, one entry (len(locked),) for each pose that was recorded [rad or m]
    poses: tuple[tuple[float, ...], ...]
    torques: tuple[int, ...]  # indices of the motors whose torque equations are used


def whole_arm(model: DynamicModel) -> Experiment:
    """Every joint free to move, every motor's torque used."""
    return Experiment((), ((),), tuple(range(model.dof)))


def find_experiment(
    model: DynamicModel, positions: Sequence[tuple[str, FloatArray]], choices: ExperimentChoices
) -> Experiment:
    """The joints that rested in all recordings, and whose torques to use.

    Args:
        model: the arm.
        positions: each recording's label and positions (N, n) as recorded [rad or m].
        choices: the user's.

    Raises:
        DataError: a joint that is declared locked moves.
        UsageError: a name that no joint has, or a tolerance that is not within 0 and `LARGEST_REST_TOLERANCE`.
    """
    if not 0.0 <= choices.rest_tolerance <= LARGEST_REST_TOLERANCE:
        unit = common_unit("rad", model.sliding)
        raise UsageError(
            f"a joint that moves over {choices.rest_tolerance:g} {unit} is not at rest",
            where="--rest-tolerance",
            hint=f"give 0 to {LARGEST_REST_TOLERANCE:g} {unit}",
        )
    named = joint_numbers(model, choices.locked, "--locked")
    spans = [(label, *ranges(position, choices.rest_tolerance)) for label, position in positions]
    still = np.all([moved <= allowed for _, moved, allowed in spans], axis=0)
    for label, moved, allowed in spans:
        for joint in named:
            if moved[joint] > allowed[joint]:
                unit = _unit(model, joint)
                raise DataError(
                    f"joint {model.joint_names[joint]} is declared locked but moves over {moved[joint]:.3g} {unit}; "
                    f"the tolerance is {allowed[joint]:.2g} {unit}",
                    where=label,
                    hint="leave it out of --locked, choose a window with --start and --stop, or give a larger "
                    "--rest-tolerance",
                )
    locked = () if bool(np.all(still)) else tuple(int(joint) for joint in np.flatnonzero(still))
    poses: list[tuple[float, ...]] = []
    for _, position in positions:
        pose = _pose(model, position, locked, choices.rest_tolerance)
        if not any(np.allclose(pose, other, rtol=0.0, atol=SAME_POSE) for other in poses):
            poses.append(pose)
    torques = joint_numbers(model, choices.torques_of, "--torques-of")
    return Experiment(locked, tuple(poses), tuple(sorted(torques)) or moving_motors(model, locked))


def joint_numbers(model: DynamicModel, names: Sequence[str], option: str) -> tuple[int, ...]:
    """Indices of joints by name.

    Raises:
        UsageError: a name that no joint has.
    """
    for name in names:
        if name not in model.joint_names:
            raise UsageError(
                f"{option}: no joint of {model.name} is called '{name}'", hint=f"joints: {', '.join(model.joint_names)}"
            )
    return tuple(dict.fromkeys(model.joint_names.index(name) for name in names))


def moving_motors(model: DynamicModel, locked: Sequence[int]) -> tuple[int, ...]:
    """Indices of the motors that turn when every joint but the locked ones moves."""
    free = [joint for joint in range(model.dof) if joint not in locked]
    return tuple(int(motor) for motor in np.flatnonzero(np.any(model.transmission.coupling[:, free] != 0.0, axis=1)))


def ranges(position: FloatArray, rest_tolerance: float) -> tuple[FloatArray, FloatArray]:
    """Largest minus smallest position (n,) of a recording (N, n), and the range up to which a joint is at rest.

    That is the tolerance [rad or m], or what the encoder's noise alone explains. The noise comes from third
    differences, which smooth motion barely affects: of white noise of standard deviation σ they have the variance
    20 σ².
    """
    nothing = np.zeros(position.shape[1])
    noise = np.std(np.diff(position, 3, axis=0), axis=0) / np.sqrt(20.0) if len(position) > 3 else nothing
    moved = np.ptp(position, axis=0) if len(position) else nothing
    return moved, np.maximum(rest_tolerance, NOISE_DEVIATIONS * noise)


def experiment_base(model: DynamicModel, experiments: Sequence[Experiment]) -> BaseParameters:
    """Base parameters that some experiments show together.

    Raises:
        IdentificationError: the rank cannot be decided, or nothing acts on the chosen torques.
    """
    if any(experiment == whole_arm(model) for experiment in experiments):
        return base_parameters(model)
    return _cached(ModelKey(model), tuple(dict.fromkeys(experiments)))


@lru_cache(maxsize=32)
def _cached(key: ModelKey, experiments: tuple[Experiment, ...]) -> BaseParameters:
    model = key.model
    kernel = RegressorKernel(model)
    accumulator = QrAccumulator(len(kernel.columns))
    for experiment_index, experiment in enumerate(experiments):
        for state in experiment_states(model, experiment, experiment_index):
            heat = random_temperature(model, state[0].shape[1])
            for _, packed in evaluate_in_chunks(kernel, *state, heat):
                for motor in experiment.torques:
                    rows = kernel.joint_rows[motor]
                    wide = np.zeros((len(kernel.columns), packed.shape[1]))
                    wide[list(rows.columns)] = packed[rows.rows]
                    accumulator.add(wide)
    factor = accumulator.factor()
    if not np.any(factor):
        raise IdentificationError(
            "no parameter acts on the torques that are used", where=model.name, hint="choose others with --torques-of"
        )
    locked = set.intersection(*(set(experiment.locked) for experiment in experiments))
    try:
        return base_parameters_of(model, factor, [model.active[joint] for joint in sorted(locked)])
    except IdentificationError as error:
        texts = "; ".join(describe(model, experiment) for experiment in experiments)
        raise IdentificationError(f"{error.message} ({texts})", where=error.where, hint=error.hint) from error


def experiment_states(
    model: DynamicModel, experiment: Experiment, experiment_index: int = 0
) -> list[tuple[FloatArray, FloatArray, FloatArray]]:
    """Random positions, velocities and accelerations (n, N), a set for each pose of the locked joints.

    Args:
        model: the arm.
        experiment: its locked joints rest.
        experiment_index: of the experiment among several: each has its own states.
    """
    count = max(100, STATES_PER_PARAMETER * len(model.parameters))
    states = []
    for place, pose in enumerate(experiment.poses):
        position, velocity, acceleration = random_states(model, count)
        turn = (place + 7 * experiment_index) % count  # other positions beside the same velocities
        position = np.roll(position, turn, axis=1)
        rows = list(experiment.locked)
        position[rows] = np.array(pose)[:, None]
        velocity[rows] = acceleration[rows] = 0.0
        states.append((position, velocity, acceleration))
    return states


def predictable_torques(
    model: DynamicModel,
    experiments: Sequence[Experiment],
    label: str,
    position: FloatArray,
    rest_tolerance: float = REST_TOLERANCE,
) -> tuple[int, ...]:
    """Indices of the motors whose torque a model from these experiments predicts along a recording (N, n).

    Args:
        model: the arm.
        experiments: that the model was identified from.
        label: of the recording.
        position: (N, n) as recorded [rad or m].
        rest_tolerance: range of positions within which a joint counts as locked [rad or m].

    Raises:
        DataError: none, since the recording moves a joint that was locked, or has it elsewhere.
    """
    if experiment_base(model, experiments).count == base_parameters(model).count:
        return tuple(range(model.dof))
    shown: set[int] = set()
    reasons = []
    for experiment in experiments:
        reason = _difference(model, experiment, position, rest_tolerance)
        if reason is None:
            shown.update(experiment.torques)
        else:
            reasons.append(reason)
    if not shown:
        raise DataError(
            f"shows a motion that the model cannot predict: {'; '.join(reasons)}",
            where=label,
            hint="validate with the same joints locked in the same place, choose another --split, or merge with an "
            "experiment that moves them",
        )
    return tuple(sorted(shown))


def _difference(model: DynamicModel, experiment: Experiment, position: FloatArray, rest_tolerance: float) -> str | None:
    """Return why a recording is not of the kind that an experiment was; None where it is."""
    moved, allowed = ranges(position, rest_tolerance)
    for joint in experiment.locked:
        if moved[joint] > allowed[joint]:
            name, unit = model.joint_names[joint], _unit(model, joint)
            return f"it moves {name} over {moved[joint]:.3g} {unit}, and {name} was locked"
    pose = _pose(model, position, experiment.locked, rest_tolerance)
    if any(np.allclose(pose, other, rtol=0.0, atol=SAME_POSE) for other in experiment.poses):
        return None
    standing = ", ".join(
        f"{model.joint_names[joint]} is at {value:.4g} {_unit(model, joint)}"
        for joint, value in zip(experiment.locked, pose, strict=True)
    )
    return f"{standing}, where the model was not identified"


def describe(model: DynamicModel, experiment: Experiment) -> str:
    """The experiment in words."""
    poses = [
        ", ".join(
            f"{model.joint_names[joint]} at {value:.4g} {_unit(model, joint)}"
            for joint, value in zip(experiment.locked, pose, strict=True)
        )
        for pose in experiment.poses
    ]
    torques = "all motors"
    if len(experiment.torques) < model.dof:
        torques = ", ".join(model.joint_names[motor] for motor in experiment.torques)
    return (f"locked: {'; or '.join(poses)}; " if experiment.locked else "") + f"torques of {torques}"


def _pose(model: DynamicModel, position: FloatArray, locked: Sequence[int], rest_tolerance: float) -> tuple[float, ...]:
    """Positions of the locked joints: the median, or the right angle from which it is indistinguishable."""
    values = []
    for joint in locked:
        value = float(np.median(position[:, joint]))
        nearest = float(np.round(value / (np.pi / 2.0)) * (np.pi / 2.0))
        near = max(RIGHT_ANGLE, min(rest_tolerance, float(np.ptp(position[:, joint]))))
        revolute = not model.joints[model.active[joint]].prismatic
        values.append(nearest if revolute and abs(value - nearest) < near else value)
    return tuple(values)


def _unit(model: DynamicModel, joint: int) -> str:
    return "m" if model.joints[model.active[joint]].prismatic else "rad"
