"""The delivered model on held-out recordings, and the verdict: one path of `identify`, `validate` and `merge`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from daq.robot.schema import Robot
from drivers.core.arrays import FloatArray
from drivers.core.text import percent_text
from drivers.core.units import joint_unit
from ident.assessment.validation import LEAST_DIFFERENCE, Fit, fit_errors, overfitting_checks
from ident.identify.data_split import PreparedRun, distinct, labelled
from ident.model.base_parameters import BaseParameters, base_parameters
from ident.model.dynamic_model import DynamicModel
from ident.model.dynamics.inverse_dynamics import InverseDynamics
from ident.regression.comparison import TorqueSeries, compare_torques, only_predicted
from ident.result.delivered import DELIVERED_WORDS, Delivered, HeldOutErrors, delivered_parameters
from ident.result.schema import Result
from ident.signals.prepared import Prepared
from ident.simulation.open_loop import OpenLoop, open_loop
from ident.simulation.tracking import TrackingError, track_longest
from ident.stored import finite_or_none
from ident.verdict.catalogue import raised
from ident.verdict.check import Check
from ident.verdict.evidence import Evidence, MotionError, TorqueError
from ident.verdict.verdict import GOOD_ERROR, GOOD_JOINT_ERROR, Verdict, judge, together

CHECKS_OF_VALIDATION = (
    "consistency-costs",
    "errors-near-standstill",
    "not-held-out",
    "not-validated",
    "overfitting",
    "simulation-failed",
)
"""Checks that depend on what was held out."""

COSTLY_RATIO = 1.2
COSTLY_DIFFERENCE = 0.02
"""Held-out error of the delivered model over the full one's, and minus it, beyond which a user has to choose."""

RATED_SHARE = 0.03
"""Share of a joint's rated torque; the error of a joint with less torque is divided by this much."""

LARGEST_SHARE = 0.02
"""The same where the robot file rates no torque, of the largest torque (root mean square) of a joint of its kind."""

LEAST_MOTION = 0.1
"""Share of the largest departure from constant velocity of a joint; one that departs less counts with this much."""


@dataclass(frozen=True, eq=False)
class ParameterSets:
    """What the parameters of an identification predict."""

    robot: Robot  # its file, whose torque limits a joint's error is compared with
    model: DynamicModel  # the arm
    base: BaseParameters  # its base parameters (b)
    full: FloatArray  # (b,) all base parameters as estimated
    consistent: FloatArray | None  # (b,) of bodies that can exist; None where none were found
    # (n,) of motors whose inertia the torque does not carry, with the consistent ones [kg·m²]
    armature: FloatArray | None = None

    @property
    def delivered(self) -> FloatArray:
        """Those that are handed out by default."""
        return self.full if self.consistent is None else self.consistent

    def series(self, values: FloatArray, prepared: Prepared, torques: Sequence[int]) -> tuple[TorqueSeries, ...]:
        """Measured and predicted torques for base parameters (b,), a series per segment."""
        columns, segments, run_filter = self.base.columns, prepared.segments, prepared.parallel_filter
        series = compare_torques(self.model, columns, values, segments, run_filter)
        return tuple(only_predicted(torque, torques) for torque in series)


@dataclass(frozen=True, eq=False)
class HeldOutRun:
    """The delivered model on one recording."""

    errors: HeldOutErrors  # as they are stored
    # in_motion, all_samples: the torques behind them
    in_motion: tuple[TorqueSeries, ...]
    all_samples: tuple[TorqueSeries, ...]


def held_out_run(
    parameters: ParameterSets, data: PreparedRun, fitted: Fit | None, label: str, checks: Sequence[Check]
) -> HeldOutRun:
    """Compare the delivered model with a recording, and simulate it along the recording.

    Args:
        parameters: of the identification.
        data: the recording, or a part of one.
        label: what messages call it.
        checks: that the recording itself raises.
        fitted: errors of the delivered model on the identification data; None of a merge.
    """
    in_motion = parameters.series(parameters.delivered, data.prepared, data.torques)
    all_samples = parameters.series(parameters.delivered, data.everything, data.torques)
    moving, every = _fit(in_motion, data), _fit(all_samples, data)
    full_moving = full_every = None
    if parameters.consistent is not None:
        full_moving = _fit(parameters.series(parameters.full, data.prepared, data.torques), data)
        full_every = _fit(parameters.series(parameters.full, data.everything, data.torques), data)
    simulated = _simulated(parameters, data)
    checks = list(checks)
    if data.overlap > 0.0:
        checks.append(_not_held_out(label, data.overlap))
    if fitted is not None:
        checks += overfitting_checks(fitted, moving)
    if simulated.failure:
        text = f"the physically consistent model could not be simulated on held-out data: {simulated.failure}"
        checks.append(raised("simulation-failed", text))
    if full_every is not None:
        checks += consistency_cost(parameters.model.joint_names, every, full_every)
    errors = HeldOutErrors(
        recording=label,
        overlap=data.overlap,
        at_rest=_share_at_rest(in_motion, all_samples),
        in_motion=moving,
        all_samples=every,
        graded_joint_error=_graded(parameters, every),
        full_in_motion=full_moving,
        full_all_samples=full_every,
        simulation=simulated.tracked,
        open_loop=simulated.driven,
        not_simulated=simulated.reason,
        checks=checks,
    )
    return HeldOutRun(errors, in_motion, all_samples)


def consistency_cost(joints: Sequence[str], delivered: Fit, full: Fit) -> list[Check]:
    """Check whether the consistent model predicts clearly worse than the full one, on the whole or for some joint."""
    worse = [
        joint
        for joint, ours, free in zip(joints, delivered.joint_relative_error, full.joint_relative_error, strict=True)
        if _costly(ours, free, LEAST_DIFFERENCE * GOOD_JOINT_ERROR / GOOD_ERROR)
    ]
    if not worse and not _costly(delivered.relative_error, full.relative_error):
        return []
    index = {joint: place for place, joint in enumerate(joints)}
    figures = [("the whole arm", delivered.relative_error, full.relative_error)] + [
        (joint, delivered.joint_relative_error[index[joint]], full.joint_relative_error[index[joint]])
        for joint in worse
    ]
    text = "; ".join(f"{name}: {percent_text(ours, 2)} against {percent_text(free, 2)}" for name, ours, free in figures)
    return [
        raised(
            "consistency-costs",
            f"held-out errors of the physically consistent model against the unconstrained one, {text}: to predict "
            'torques take load_model(…, parameters="full"); to simulate there is only the consistent one. Check the '
            "geometry, the drive gains and the signs of the torques",
            worse,
        )
    ]


def delivered_model(consistent: object | None, fitted: Fit | None, runs: Sequence[HeldOutRun]) -> Delivered:
    """The section `delivered` of a result.

    Args:
        consistent: the physically consistent parameters; None where there are none.
        fitted: errors of the delivered model on the identification data; None of a merge.
        runs: held-out recordings.
    """
    return Delivered(
        parameters=delivered_parameters(consistent),
        fit=fitted,
        validation=_of_all([run.in_motion for run in runs], runs),
        validation_all_samples=_of_all([run.all_samples for run in runs], runs),
        runs=[run.errors for run in runs],
    )


def model_verdict(result: Result, checks: Sequence[Check], runs: Sequence[HeldOutErrors]) -> Verdict:
    """The verdict on a model: the worst of its held-out recordings, of which those of the identification do not count.

    Args:
        result: the model, its own verdict left aside.
        checks: of the model itself and of the data that it was identified from.
        runs: the delivered model on recordings.
    """
    counted = [run for run in runs if run.overlap < 1.0] or runs
    labels = distinct([run.recording for run in counted])
    counted = [run.model_copy(update={"recording": label}) for run, label in zip(counted, labels, strict=True)]
    basis = _basis(result, counted)
    if not counted:
        missing = raised("not-validated", "the model was not validated on held-out data (--validate)")
        return judge([*checks, missing], _nothing(result.joints), basis)
    of_runs = [(run.recording, judge([*checks, *run.checks], _evidence(result, run), basis)) for run in counted]
    return together(of_runs)


def model_checks(result: Result) -> list[Check]:
    """The checks of a stored model itself, without those of its validation."""
    of_runs = {check for run in result.delivered.runs for check in run.checks}
    return [check for check in result.verdict.checks if check not in of_runs and check.name not in CHECKS_OF_VALIDATION]


def _nothing(joints: Sequence[str]) -> Evidence:
    return Evidence(TorqueError(None), dict.fromkeys(joints, TorqueError(None)))


def _evidence(result: Result, run: HeldOutErrors) -> Evidence:
    """Return what a grade follows from; nothing where the recording is the identification's own."""
    joints = result.joints
    if run.overlap >= 1.0:
        return _nothing(joints)
    every, moving = run.all_samples, run.in_motion
    of_joints = {
        joint: TorqueError(
            every.joint_relative_error[place], moving.joint_relative_error[place], run.graded_joint_error[place]
        )
        for place, joint in enumerate(joints)
    }
    return Evidence(TorqueError(every.relative_error, moving.relative_error), of_joints, tuple(_motions(result, run)))


def _motions(result: Result, run: HeldOutErrors) -> Iterator[MotionError]:
    """Simulated motions whose errors can be compared with constant velocity."""
    for simulated, text in (
        (run.open_loop, "motion simulated without a controller"),
        (run.simulation, "motion simulated with a soft controller"),
    ):
        if simulated is not None and simulated.ratio is not None:
            ratios = [float("inf") if ratio is None else ratio for ratio in simulated.joint_ratio]
            errors = [
                "of unknown size" if error is None else f"{error:.2g} {joint_unit('rad', sliding=slides)}"
                for error, slides in zip(simulated.position_rmse, result.sliding, strict=True)
            ]
            yield MotionError(
                simulated.ratio,
                dict(zip(result.joints, ratios, strict=True)),
                dict(zip(result.joints, errors, strict=True)),
                text,
            )


def _basis(result: Result, runs: Sequence[HeldOutErrors]) -> str:
    """Return what was compared with what, and how much the model holds."""
    parameters = delivered_parameters(result.consistent)
    sentences = [
        f"On {labelled(run.recording, run.overlap)}, the torque of the {DELIVERED_WORDS[parameters]} model, which "
        f"load_model hands out, differs from measured torque by {percent_text(run.in_motion.relative_error)} in motion "
        f"and {percent_text(run.all_samples.relative_error)} over all samples{_rest(run)}."
        for run in runs
    ]
    fitted = result.delivered.fit
    if fitted is not None:
        sentences.append(f"On the identification data it differs by {percent_text(fitted.relative_error)}.")
    significant = sum(parameter.significant for parameter in result.base_parameters)
    sentences.append(
        f"{significant} of {len(result.base_parameters)} base parameters are significant; the essential model keeps "
        f"{result.essential.count} of them."
    )
    if any(experiment.locked or len(experiment.torques_of) < len(result.joints) for experiment in result.experiments):
        described = [step.text for step in result.preprocessing if step.name == "experiment"]
        sentences += [
            f"All of this applies to the experiment as recorded: {text}." for text in dict.fromkeys(described)
        ]
    return " ".join(sentences)


def _rest(run: HeldOutErrors) -> str:
    """Torques of motors at rest among all samples, in words."""
    if not run.at_rest:
        return ""
    return (
        f", of which {percent_text(run.at_rest, 2)} are of motors at rest, whose static friction is anything up to the "
        "Coulomb friction"
    )


def _not_held_out(label: str, overlap: float) -> Check:
    share = "its samples" if overlap >= 1.0 else f"{percent_text(overlap, 2)} of its samples"
    text = f"{label} is not held out: {share} were used in the identification; validate with another recording"
    return raised("not-held-out", text)


def _costly(delivered: float | None, full: float | None, least: float = LEAST_DIFFERENCE) -> bool:
    """Return whether two relative errors differ by what a user has to know, at `least` by so much."""
    if delivered is None or full is None:
        return False
    difference = delivered - full
    return difference > COSTLY_DIFFERENCE or (difference > least and delivered > COSTLY_RATIO * full)


def _fit(series: Sequence[TorqueSeries], data: PreparedRun) -> Fit:
    return fit_errors(series, held_out=data.overlap == 0.0)


def _of_all(series: Sequence[Sequence[TorqueSeries]], runs: Sequence[HeldOutRun]) -> Fit | None:
    """Errors over all recordings together."""
    if not runs:
        return None
    parts = [torque for of_run in series for torque in of_run]
    return fit_errors(parts, held_out=all(run.errors.held_out for run in runs))


def _share_at_rest(in_motion: Sequence[TorqueSeries], all_samples: Sequence[TorqueSeries]) -> float:
    """Share of all samples' torques that do not count in motion."""
    moving, every = (sum(int(torque.counted.sum()) for torque in series) for series in (in_motion, all_samples))
    return 1.0 - moving / max(1, every)


def _graded(parameters: ParameterSets, errors: Fit) -> list[float | None]:
    """Each joint's relative error, over at least a share of its rated torque (`RATED_SHARE`, `LARGEST_SHARE`)."""
    names, sliding = parameters.robot.joint_names, parameters.model.sliding
    torques = [
        0.0 if rmse is None or not ratio else rmse / ratio
        for rmse, ratio in zip(errors.rmse, errors.joint_relative_error, strict=True)
    ]
    graded = []
    for place, limits in enumerate(parameters.robot.joints):
        of_kind = max(torque for torque, other in zip(torques, sliding, strict=True) if other == sliding[place])
        least = LARGEST_SHARE * of_kind if limits.torque is None else RATED_SHARE * limits.torque
        rmse, scale = errors.rmse[place], max(torques[place], least)
        graded.append(errors.joint_relative_error[place] if rmse is None or scale == 0.0 else rmse / scale)
    assert len(graded) == len(names)
    return graded


def _whole(parameters: ParameterSets) -> bool:
    """Return whether the parameters are those of the whole arm."""
    return parameters.base.count == base_parameters(parameters.model).count


@dataclass(frozen=True)
class _Simulated:
    """Motion errors with a soft controller and without one; why there are none; what failed."""

    tracked: TrackingError | None = None
    driven: OpenLoop | None = None
    reason: str = ""
    failure: str = ""


def _simulated(parameters: ParameterSets, data: PreparedRun) -> _Simulated:
    """The motion of the simulated arm beside the recorded one."""
    if parameters.consistent is None:
        return _Simulated(reason="there are no physically consistent parameters")
    if not _whole(parameters) or len(data.torques) < parameters.model.dof:
        return _Simulated(reason="not all joints moved, or not all torques were used")
    inverse = InverseDynamics(parameters.model, parameters.base, parameters.consistent, armature=parameters.armature)
    segments, sliding = data.prepared.segments, parameters.model.sliding
    tracked, failure = track_longest(inverse, segments)
    driven = open_loop(inverse, segments)
    if driven is None:
        return _Simulated(tracked, None, failure, failure)
    if tracked is not None:
        tracked = tracked.model_copy(update=_ratios(tracked.position_rmse, driven.reference_rmse, sliding))
    driven = driven.model_copy(update=_ratios(driven.position_rmse, driven.reference_rmse, sliding))
    return _Simulated(tracked, driven, failure, failure or driven.diverged)


def _ratios(errors: Sequence[float | None], references: Sequence[float], sliding: Sequence[bool]) -> dict[str, Any]:
    """Errors over those of constant velocity: the larger one of rotations and of slides together, and of each joint.

    A joint that hardly departs from constant velocity is compared with `LEAST_MOTION` of the one that departs most.
    """
    error, reference = np.array(errors, dtype=np.float64), np.array(references)
    kinds, ratios, of_kinds = np.array(sliding), np.zeros(len(error)), [0.0]
    for kind in set(sliding):
        own = kinds == kind
        largest = float(np.max(reference[own]))
        if largest == 0.0:
            continue
        ratios[own] = error[own] / np.maximum(reference[own], LEAST_MOTION * largest)
        of_kinds.append(float(np.sqrt(np.sum(error[own] ** 2) / np.sum(reference[own] ** 2))))
    whole, of_joints = float(np.max(of_kinds)), ratios.tolist()
    return {"ratio": finite_or_none(whole), "joint_ratio": [finite_or_none(ratio) for ratio in of_joints]}
