"""From friction experiments to the result that is written to disk, and to a table."""

from __future__ import annotations

import numpy as np

from daq.recording.recording import software_versions
from drivers.core.units import ZERO_CELSIUS
from ident.experiments.friction.experiment import FrictionExperiment
from ident.experiments.friction.joint_friction import JointFriction
from ident.friction.table import LEAST_TEMPERATURE_SPAN, TEMPERATURE_KINDS, temperature_coefficients
from ident.result.friction import friction_fields
from ident.result.friction_experiment import FrictionExperimentResult, JointFrictionExperiment, ValueRange


def friction_result(experiment: FrictionExperiment) -> FrictionExperimentResult:
    """Output of `dynid friction --json`."""
    data = experiment.periods.data
    names, moved = experiment.periods.model.joint_names, {joint.joint for joint in experiment.joints}
    search = data.delay
    return FrictionExperimentResult(
        robot=experiment.robot_file.robot.name,
        recordings=list(experiment.recordings),
        torque_origin=data.runs[0].signals.torque_origin,
        asked=experiment.asked,
        delay=data.choices.delay,
        delay_note="as given, not searched" if search is None else search.note,
        joints=[
            _joint_result(joint, experiment.periods.model.joints[names.index(joint.joint)].prismatic)
            for joint in experiment.joints
        ],
        friction_steps=[step for joint in experiment.joints for step in joint.steps],
        not_moved=[name for name in names if name not in moved],
        versions=software_versions(),
    )


def _joint_result(joint: JointFriction, sliding: bool) -> JointFrictionExperiment:
    value = dict(zip(joint.kinds, joint.values.tolist(), strict=True))
    std = dict(zip(joint.kinds, np.sqrt(np.diag(joint.covariance)).tolist(), strict=True))
    terms = joint.terms
    found = friction_fields(terms, 0, value, value.get, std.get)
    places = [joint.kinds.index(kind) for kind in TEMPERATURE_KINDS if kind in value]
    if places:
        to_beta = np.array([temperature_coefficients(*unit) for unit in np.eye(3)])[: len(places)].T
        covariance = to_beta @ joint.covariance[np.ix_(places, places)] @ to_beta.T
        found["temperature"] = (to_beta @ joint.values[places]).tolist()
        found["temperature_std"] = np.sqrt(np.diag(covariance)).tolist()
    heat = joint.temperature
    return JointFrictionExperiment(
        joint=joint.joint,
        **found,
        temperature_term="full" if len(places) == 3 else "linear" if places else "none",
        kinds=list(joint.kinds),
        values=joint.values.tolist(),
        covariance=np.where(np.isfinite(joint.covariance), joint.covariance, np.inf).tolist(),
        sliding=sliding,
        speed_range=ValueRange.model_validate(joint.speed),
        temperature_range=None
        if heat is None
        else ValueRange(least=heat.least - ZERO_CELSIUS, greatest=heat.greatest - ZERO_CELSIUS),
        load_range=ValueRange.model_validate(joint.load),
        least_temperature_span=LEAST_TEMPERATURE_SPAN,
        least_load_span=joint.least_load_span,
        rmse=joint.rmse,
        samples=joint.samples,
        periods=joint.periods,
        settled=joint.settled,
        notes=list(joint.notes),
    )
