"""What a user should know before trusting an identification's numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from daq.recording import Recording
from drivers.errors import IdentificationError
from ident.assessment.plausibility import (
    POSES,
    fits_opposite_gravity,
    indefinite_share,
    inertia_matrices,
    sign_warnings,
)
from ident.estimators.estimator import estimable, estimator_of, fits_energy_better
from ident.identify.identification import Identification
from ident.model.regressor import RegressorKernel
from ident.regression.least_squares import ENERGY_METHODS, ordinary_least_squares
from ident.regression.observability import experiment_states, moving_motors, whole_arm
from ident.regression.observation_matrix import only_torques
from ident.regression.pruning import relative_std
from ident.regression.velocity_reversals import ADVISED_SHARE, leave_out_reversals

ROWS_PER_PARAMETER = 50
"""Fewer equations a parameter than this are warned of (SR400 .4.3 point 6)."""

MOVED = 3.0
"""Friction that moves by more standard deviations than this without reversals is warned of; on motions that were
followed exactly it moves by up to 2.4, since data are left out."""
NEGLIGIBLE = 1e-3
"""Share of a value that is no matter, however small its standard deviation."""


def identification_warnings(found: Identification, recordings: Sequence[Recording]) -> list[str]:
    """What a user should know before trusting the numbers."""
    warnings = []
    base, solution = found.base, found.solution
    for recording in recordings:
        if not recording.complete:
            warnings.append(f"{recording.label} was not closed in order: its end may be missing")
    count = len(solution.active)
    if solution.rows < ROWS_PER_PARAMETER * count:
        more = "take shorter windows" if found.choices.method == "energy" else "decimate less"
        warnings.append(
            f"only {solution.rows} equations for {count} parameters; {ROWS_PER_PARAMETER} a parameter are advised: "
            f"record longer or {more}"
        )
    warnings += _experiment_warnings(found)
    unseen = [base.names[i] for i in range(base.count) if i not in estimable(found.choices.method, found.model, base)]
    if unseen:
        warnings.append(
            f"the energy model cannot tell {', '.join(unseen)} from the others, the dynamic model can: use --method wls"
        )
    silent = [base.names[i] for i in range(base.count) if i not in solution.active and base.names[i] not in unseen]
    if silent:
        warnings.append(
            f"the motion does not excite {', '.join(silent)}: no values for them, and other parameters may have taken "
            "theirs up"
        )
    vague = [
        base.names[i]
        for i in solution.active
        if relative_std(solution.parameters, found.std)[i] >= 100.0 and i in found.pruned.dropped
    ]
    if len(vague) > base.count / 3:
        warnings.append(
            f"{len(vague)} of {base.count} base parameters are smaller than their standard deviation: "
            "a more exciting motion would tell more"
        )
        if found.choices.method in ENERGY_METHODS:
            warnings.append(
                "the energy model has one equation for all joints together: record many different moves rather than a "
                "periodic motion, or use --method wls"
            )
    warnings += sign_warnings(base, solution.parameters, found.std)
    if np.any(found.model.gravity) and _fits_opposite_gravity(found):
        warnings.append(
            "gravity of the opposite sign fits the data better: check `model.gravity`, how the arm is mounted, and the "
            "signs of the drive gains"
        )
    warnings += _reversal_warnings(found)
    share = _indefinite_share(found)
    if share > 0:
        warnings.append(
            f"the identified inertia matrix is not positive definite at {share * 100:.0f} % of random poses: good for "
            "predicting torque, not for forward simulation"
        )
    if found.validation.relative_error > 2.0 * found.fit.relative_error:
        warnings.append(
            f"the validation error is {found.validation.relative_error / found.fit.relative_error:.1f} times the "
            "identification's: the model has learnt its data by heart, or the other motion shows what this one hides "
            "(slow motion: ripple, friction near standstill)"
        )
    return warnings


def _experiment_warnings(found: Identification) -> list[str]:
    """What was found to stand still and nobody said so; torques of motors at rest."""
    experiment, names = found.experiment, found.model.joint_names
    warnings = []
    unsaid = [names[joint] for joint in experiment.locked if names[joint] not in found.choices.experiment.locked]
    if unsaid:
        warnings.append(
            f"{', '.join(unsaid)} did not move: the base parameters are those of the arm with "
            f"{'this joint' if len(unsaid) == 1 else 'these joints'} fixed, and hold for no other position of "
            f"{'it' if len(unsaid) == 1 else 'them'}; name what is locked on purpose with --locked"
        )
    turning = moving_motors(found.model, experiment.locked)
    held = [names[motor] for motor in experiment.torques if motor not in turning]
    if held:
        warnings.append(
            f"the motor of {', '.join(held)} does not turn, and its torque is used: static friction or a brake may "
            "hold any part of it"
        )
    return warnings


def _reversal_warnings(found: Identification) -> list[str]:
    """Friction that is another without the equations of motors that turn round."""
    choices, base, before = found.choices, found.base, found.solution
    if choices.method in ENERGY_METHODS or choices.reversals:
        return []
    kernel = RegressorKernel(found.model, base.columns)
    parts = [leave_out_reversals(kernel, run.prepared, ADVISED_SHARE) for run in found.runs]
    estimator = estimator_of(choices.method, kernel, parts, None)
    try:
        after = estimator.solve(only_torques(estimator.reduce(parts), found.experiment.torques), before.active)
    except IdentificationError:  # too little is left
        return []
    kinds = [found.model.parameters[column].kind for column in base.columns]
    moved = {
        i: (after.parameters[i] - before.parameters[i]) / found.std[i]
        for i in before.active
        if kinds[i] in ("viscous", "coulomb")
        and abs(after.parameters[i] - before.parameters[i]) > NEGLIGIBLE * abs(before.parameters[i])
    }
    told = sorted((i for i in moved if abs(moved[i]) > MOVED), key=lambda i: -abs(moved[i]))[:3]
    if not told:
        return []
    changes = ", ".join(f"{base.names[i]} by {moved[i]:+.1f}" for i in told)
    return [
        f"friction is no constant where joints turn round: without those equations it moves ({changes} standard "
        f"deviations), which the error bars do not cover; compare --leave-out-reversals {ADVISED_SHARE:g}"
    ]


def _indefinite_share(found: Identification) -> float:
    """Share of random poses at which the inertia matrix of the joints that moved is not positive definite."""
    model, experiment, parameters = found.model, found.experiment, found.solution.parameters
    if experiment == whole_arm(model):
        return indefinite_share(model, found.base, parameters)
    moving = [joint for joint in range(model.dof) if joint not in experiment.locked]
    rows = [joint for joint in moving if joint in experiment.torques]
    if model.transmission is not None and rows != moving:  # a coupled motor's row belongs to several joints
        return 0.0
    position = np.concatenate([state[0] for state in experiment_states(model, experiment)], axis=1)
    few = position[:, :: max(1, position.shape[1] // POSES)]
    matrices = inertia_matrices(model, found.base, parameters, few)[:, rows][:, :, rows]
    smallest = np.linalg.eigvalsh(0.5 * (matrices + matrices.transpose(0, 2, 1)))[:, 0]
    return float(np.mean(smallest <= 0.0))


def _fits_opposite_gravity(found: Identification) -> bool:
    """Whether the same equations with gravity of the opposite sign fit clearly better, both by OLS."""
    active, model, method = found.solution.active, found.model, found.choices.method
    residual_sum = ordinary_least_squares(found.reduction, active).residual_sum
    parts = [run.prepared for run in found.runs]
    if method not in ENERGY_METHODS:
        prepared = [(part.segments, part.parallel_filter) for part in parts]
        return fits_opposite_gravity(model, found.base, prepared, active, residual_sum, found.experiment.torques)
    kernel = RegressorKernel(replace(model, gravity=-model.gravity), found.base.columns)
    turned = estimator_of(method, kernel, parts, found.choices.energy_window)
    independent = found.corrected.effective_rows * found.corrected.repetitions
    return fits_energy_better(turned, parts, active, residual_sum, independent)
