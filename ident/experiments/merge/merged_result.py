"""Merge several results of one arm into one Result: which models may be merged, and the merged result."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from daq.recording.recording import Recording
from drivers.core.arrays import FloatArray
from drivers.core.text import counted, percent_text
from ident.assessment.delay.delay import DelaySearch
from ident.assessment.plausibility import indefinite_share, sign_checks
from ident.assessment.validation import Fit
from ident.estimators.feasible.consistent import ConsistentParameters, found_consistent
from ident.experiments.merge.merge import CONTRADICTING, MergedEstimate, identifiable_columns, merge
from ident.experiments.merge.merge_input import MergeInput, merge_inputs, used_recordings
from ident.identify.checks.body_checks import body_checks
from ident.identify.checks.estimate_checks import consistency_checks
from ident.identify.checks.extrapolation import extrapolation_checks
from ident.identify.data_split import labelled
from ident.identify.held_out import HeldOutRun, delivered_model, model_verdict
from ident.identify.revalidate import Revalidation, revalidate
from ident.identify.summary import gain_results, parameter_results
from ident.model.base_parameters import BaseParameters, base_parameters
from ident.model.dynamic_model import DynamicModel
from ident.regression.estimate import Estimate
from ident.regression.options import SIGNIFICANT_RSD, EssentialOptions, EssentialRule
from ident.regression.pruning import Pruned, prune
from ident.regression.repeatability import RunDeviations, friction_columns, friction_sizes, repeatability
from ident.result.consistent_model import consistent_model, link_results
from ident.result.delivered import Delivered, delivered_parameters
from ident.result.estimate import Consistency, Contradiction, EstimateResult, ExperimentResult, Merge, MergedModel
from ident.result.friction import friction_note, friction_results
from ident.result.schema import Essential, Excitation, Residuals, Result
from ident.verdict.catalogue import raised
from ident.verdict.check import Check
from ident.verdict.verdict import Verdict

MOST_CONTRADICTIONS = 10
"""So many are named."""

CHECKED_AGAIN = ("indefinite-inertia", "no-consistent-model", "simulation-failed")
"""Checks of the merged model itself, independent of those of its inputs."""


def merge_results(
    results: Sequence[tuple[str, Result]],
    held_out: Recording | None = None,
    essential: EssentialRule = EssentialOptions.essential,
    threshold: float = SIGNIFICANT_RSD,
) -> tuple[Result, Revalidation | None]:
    """One model from several.

    Returns:
        The merged result, and the held-out torques where there are any.

    Raises:
        UsageError: fewer than two, different arms, or data that would count twice.
        ResultFileError: a result without a covariance, or inconsistent results.
        IdentificationError: the values do not determine any parameter.
    """
    inputs, base = merge_inputs(results)
    model = inputs[0].stored.model
    informations = [source.information for source in inputs]
    merged = merge(informations, identifiable_columns(informations, range(base.count)))
    within = merged.covariance
    merged, between = _with_repeatability(base, inputs, merged)
    std = np.full(base.count, np.inf)
    std[list(merged.solution.active)] = np.sqrt(np.diag(merged.covariance))
    inflation = np.ones(base.count)  # what changes between runs is no reason to leave a parameter out
    inflation[list(merged.solution.active)] = (
        np.sqrt(np.diag(within)) / merged.solution.std[list(merged.solution.active)]
    )
    rows = sum(source.result.residuals.effective_rows or 0.0 for source in inputs)
    pruned = prune(
        merged.solution, inflation, rows, lambda columns: merge(informations, columns).solution, essential, threshold
    )
    result, estimate, consistent = _result(
        model, base, inputs, merged, within, std, between, pruned, essential, threshold
    )
    whole = base.count == base_parameters(model).count
    robot_file = inputs[0].stored.robot_file
    bodies = [] if consistent is None else body_checks(model, robot_file, base, estimate, consistent, whole=whole)
    checks = [*result.verdict.checks, *consistency_checks(model.link_names, consistent), *bodies]
    if held_out is None:
        return _judged(result, checks, ()), None
    validated = revalidate(result, held_out)
    return _judged(_with_validation(result, validated), checks, (validated.delivered,)), validated


def _with_repeatability(
    base: BaseParameters, inputs: Sequence[MergeInput], merged: MergedEstimate
) -> tuple[MergedEstimate, FloatArray | None]:
    """The merged estimate with the σ of friction between its models in the covariance, and that σ (b,)."""
    active = merged.solution.active
    friction = friction_columns(base, active)
    names = [base.names[active[place]] for place in friction]
    values, variances = (np.full((len(inputs), len(names)), np.nan) for _ in range(2))
    places = [
        [(source.names.index(name), at) for at, name in enumerate(names) if name in source.names] for source in inputs
    ]
    for number, (source, pairs) in enumerate(zip(inputs, places, strict=True)):
        for own, at in pairs:
            values[number, at] = source.information.values[own] - merged.fitted[number][own]
            variances[number, at] = source.information.covariance[own, own]
    if not np.any(np.sum(np.isfinite(values), axis=0) > 1):
        return merged, None
    kinds = tuple(str(base.kinds[active[place]]) for place in friction)
    sizes = friction_sizes(base, active, merged.solution.parameters)
    std, factor = repeatability(RunDeviations(values, variances, sizes, kinds))
    widened = []
    for source, pairs in zip(inputs, places, strict=True):
        covariance = source.information.covariance.copy()
        for own, at in pairs:
            covariance[own, own] += (std[at] * factor[at]) ** 2
        widened.append(replace(source.information, covariance=covariance))
    between = np.full(base.count, np.nan)
    between[[active[place] for place in friction]] = std
    return replace(merged, covariance=merge(widened, active).covariance), between


def _result(
    model: DynamicModel,
    base: BaseParameters,
    inputs: Sequence[MergeInput],
    merged: MergedEstimate,
    within: FloatArray,
    std: FloatArray,
    between: FloatArray | None,
    pruned: Pruned,
    essential: EssentialRule,
    threshold: float,
) -> tuple[Result, Estimate, ConsistentParameters | None]:
    first, solution = inputs[0].result, merged.solution
    unexcited = [base.names[i] for i in range(base.count) if i not in solution.active]
    consistency = _consistency(inputs, merged)
    checks = _checks(model, base, inputs, merged, std, unexcited, consistency)
    estimate = Estimate(
        active=solution.active,
        values=solution.parameters[list(solution.active)],
        root=merged.root,
        covariance=merged.covariance,
        absorbed=merged.absorbed,
        blocks=min(source.information.blocks for source in inputs),
        within=within,
    )
    residuals = _residuals(inputs)
    robot_file = inputs[0].stored.robot_file
    consistent = found_consistent(model, base, estimate, robot_file)
    values, moves = (solution.parameters, None) if consistent is None else (consistent.base, consistent.base_moves)
    checks += extrapolation_checks(model, base, values, within, solution.active, moves)
    result = Result.of(
        robot_file,
        method=f"merge of {' and '.join(source.result.method for source in inputs)}",
        options={
            **first.options,
            "start": None,
            "stop": None,
            "split": None,
            "essential": essential,
            "significance": threshold,
        },
        model_options=first.model_options,
        preprocessing=[
            replace(step, text=f"{source.label}: {step.text}")
            for source in inputs
            for step in source.result.preprocessing
        ],
        delay=DelaySearch(used=first.delay.used, best=first.delay.best, note=f"of {inputs[0].label}"),
        base_parameters=parameter_results(model, base, solution, std, pruned, threshold, repeatability=between),
        friction=friction_results(model, base, solution, std, merged.covariance, {}, between),
        friction_note=friction_note(len(inputs), between),
        standard_parameters=None if consistent is None else link_results(model, consistent),
        consistent=None if consistent is None else consistent_model(model, base, robot_file, consistent),
        drive_gains=gain_results(
            robot_file.robot, {gain.joint for source in inputs for gain in source.result.drive_gains}
        ),
        fit=None,
        validation=None,
        validation_source="",
        essential=Essential.of(base.names, pruned),
        excitation=Excitation.of(base.names, solution, merged.root),
        residuals=residuals,
        rank_margin=base.margin,
        recordings=[use for source in inputs for use in used_recordings(source.result)],
        verdict=Verdict("not judged yet", checks=tuple(checks)),
        delivered=Delivered(parameters=delivered_parameters(consistent)),
        experiments=[
            ExperimentResult.of(model, experiment) for source in inputs for experiment in source.stored.experiments
        ],
        merge=Merge(
            models=[
                MergedModel(
                    file=source.label,
                    method=source.result.method,
                    experiments=[ExperimentResult.of(model, experiment) for experiment in source.stored.experiments],
                    parameters=len(source.names),
                    variance_ratio=source.ratio,
                )
                for source in inputs
            ],
            consistency=consistency,
        ),
        estimate=EstimateResult.of(estimate, base.names, model.joint_names),
    )
    return result, estimate, consistent


def _residuals(inputs: Sequence[MergeInput]) -> Residuals:
    """Those of the experiments: of each joint, where its torque was used with the most equations."""
    stored = [source.result.residuals for source in inputs]

    def best(name: str, joint: int) -> float | None:
        stated = [
            (residuals.rows, value) for residuals in stored if (value := getattr(residuals, name)[joint]) is not None
        ]
        return max(stated)[1] if stated else None

    joints = range(len(inputs[0].result.joints))
    return Residuals(
        rows=sum(residuals.rows for residuals in stored),
        effective_rows=sum(residuals.effective_rows or 0.0 for residuals in stored),
        joint_std=[best("joint_std", joint) for joint in joints],
        autocorrelation=[best("autocorrelation", joint) for joint in joints],
        block_length=max(residuals.block_length for residuals in stored),
        blocks=min(residuals.blocks for residuals in stored),
        repetitions=max(residuals.repetitions for residuals in stored),
        correction="the covariances of the models, carried through the merge",
    )


def _consistency(inputs: Sequence[MergeInput], merged: MergedEstimate) -> Consistency | None:
    test = merged.consistency
    if test is None:
        return None
    contradictions = [
        Contradiction(
            file=source.label, parameter=name, value=float(value), merged=float(fitted), deviations=float(deviation)
        )
        for source, deviations, fits in zip(inputs, merged.deviations, merged.fitted, strict=True)
        for name, value, fitted, deviation in zip(
            source.names, source.information.values, fits, deviations, strict=True
        )
        if abs(deviation) > CONTRADICTING
    ]
    contradictions.sort(key=lambda combination: -abs(combination.deviations))
    shared = f"the {counted(test.freedom, 'combination')} of parameters that several models share"
    outcome = f"χ² = {test.statistic:.1f}, {test.p_text}"
    if test.passed:
        text = f"The models agree on {shared} ({outcome})."
    else:
        text = (
            f"The models contradict each other on {shared} ({outcome}): another arm, load, temperature or drive gains, "
            "or error bars that are too small."
        )
    return Consistency(
        statistic=test.statistic,
        freedom=test.freedom,
        p_value=test.p_value,
        agree=test.passed,
        text=text,
        contradictions=contradictions[:MOST_CONTRADICTIONS],
    )


def _checks(
    model: DynamicModel,
    base: BaseParameters,
    inputs: Sequence[MergeInput],
    merged: MergedEstimate,
    std: FloatArray,
    unexcited: Sequence[str],
    consistency: Consistency | None,
) -> list[Check]:
    checks = []
    if consistency is not None and not consistency.agree:
        worst = ", ".join(
            f"{contradiction.parameter} of {contradiction.file} ({contradiction.deviations:+.1f} σ)"
            for contradiction in consistency.contradictions[:3]
        )
        text = consistency.text + (f" Furthest from the merged model: {worst}." if worst else "")
        checks.append(raised("contradicting-models", text))
    if unexcited:
        text = f"the recordings do not excite {', '.join(unexcited)}: they get no value"
        checks.append(raised("unexcited-parameters", text))
    whole = base_parameters(model)
    if base.count < whole.count:
        text = (
            f"together the experiments can show {base.count} of the arm's {whole.count} base parameters: the model "
            "predicts only the torques that were used, with the joints locked as they were"
        )
        checks.append(raised("partial-model", text))
    elif (share := indefinite_share(model, base, merged.solution.parameters)) > 0:
        text = (
            f"the inertia matrix of the unconstrained parameters is not positive definite at {percent_text(share, 2)} "
            "of random poses; that of the physically consistent ones always is"
        )
        checks.append(raised("indefinite-inertia", text))
    checks += sign_checks(base, merged.solution.parameters, std)
    for source in inputs:
        checks += _checks_of_part(source)
    return checks


def _checks_of_part(source: MergeInput) -> list[Check]:
    """Checks of an input that concern the merge: wrong data remain wrong, another input may excite what it does not."""
    own = source.result.verdict.checks
    inherited = [check for check in own if check.severity == "serious" and check.name not in CHECKED_AGAIN]
    checks = [replace(check, text=f"{source.label}: {check.text}") for check in inherited]
    if count := len(own) - len(inherited):
        text = f"{source.label} has {counted(count, 'other check' if inherited else 'check')} of its own"
        checks.append(raised("checks-of-a-part", text))
    return checks


def _judged(result: Result, checks: Sequence[Check], runs: Sequence[HeldOutRun]) -> Result:
    """The result with what is delivered, and the verdict on that."""
    delivered = delivered_model(result.consistent, None, runs)
    result = result.model_copy(update={"delivered": delivered})
    verdict = model_verdict(result, checks, delivered.runs)
    agreement = result.merge.consistency.text if result.merge and result.merge.consistency else ""
    text = agreement or "The models share no comparable combination."
    return result.model_copy(update={"verdict": replace(verdict, basis=f"{text} {verdict.basis}")})


def _with_validation(result: Result, validated: Revalidation) -> Result:
    """The result with its held-out errors."""
    errors = validated.delivered.errors

    def marked(figures: Fit) -> Fit:
        return figures.model_copy(update={"held_out": errors.held_out})

    essential = result.essential.model_copy(update={"validation": marked(validated.essential)})
    consistent = result.consistent
    if consistent is not None and validated.consistent is not None:
        consistent = consistent.model_copy(
            update={
                "validation": marked(validated.consistent),
                "simulation": errors.simulation,
                "not_simulated": errors.not_simulated,
            }
        )
    source = labelled(errors.recording, errors.overlap)
    changes = {"validation": marked(validated.full), "validation_source": source, "essential": essential}
    return result.model_copy(update=changes | {"consistent": consistent})
