"""A result at the terminal."""

from __future__ import annotations

from collections.abc import Sequence

from daq.commands.console import print_table
from drivers.percentage import in_percent, percent_text
from ident.result.schema import Fit, Merge, Result
from ident.verdict.verdict import Verdict


def print_result(result: Result) -> None:
    """The result as a person reads it at the terminal."""
    for step in result.preprocessing:
        print(f"{step.name}: {step.text}")
    print(f"delay: {result.delay.note}")
    if result.merge is not None:
        _print_merge(result.merge)
    print_table(
        f"\nBase parameters ({result.method}); σ corrected for autocorrelated residuals",
        ("name", "value", "σ", "RSD [%]", "F", "significant", "unit"),
        [
            (p.name, p.value, p.std, p.rsd_percent, p.f_value, "yes" if p.significant else "no", p.unit)
            for p in result.base_parameters
        ],
    )
    _print_friction(result)
    validation = result.validation
    print_table(
        "\nErrors",
        ("joint", "RMSE fit", "RMSE validation", "at low speed", "at high speed", "relative [%]"),
        [
            (
                joint,
                result.fit.rmse[i] if result.fit else None,
                validation.rmse[i] if validation else None,
                validation.low_speed_rmse[i] if validation else None,
                validation.high_speed_rmse[i] if validation else None,
                in_percent(validation.joint_relative_error[i]) if validation else None,
            )
            for i, joint in enumerate(result.joints)
        ],
    )
    _print_simulation(result)
    print(
        f"\ncondition number {result.excitation.condition:.4g}, "
        f"column-normalised {result.excitation.scaled_condition:.4g}"
    )
    print_verdict(result.verdict)
    if result.acceptance is not None:
        print(f"\n{result.acceptance}")


def _print_friction(result: Result) -> None:
    """Further friction terms of the joints that have some, and the steps that led there."""
    further = [(joint.joint, joint.terms_text) for joint in result.friction if joint.terms_text]
    if further:
        print_table("\nFurther friction, ± 95 %", ("joint", "terms"), further)
    if result.friction_steps:
        print_table(
            "\nFriction terms tried",
            ("joint", "term", "F", "p", "held-out error before", "after", "added"),
            [
                (step.joint, step.term, step.f_value, step.p_value, step.error_before, step.error_after, yes_no)
                for step in result.friction_steps
                for yes_no in ["yes" if step.accepted else "no"]
            ],
        )


def _print_simulation(result: Result) -> None:
    """Motion error of the simulated consistent model beside its torque error."""
    consistent = result.consistent
    if consistent is None or consistent.simulation is None or consistent.validation is None:
        if consistent is not None and consistent.not_simulated:
            print(f"\nconsistent model not simulated on held-out motion: {consistent.not_simulated}")
        return
    motion = consistent.simulation
    print_table(
        f"\nConsistent model simulated on held-out motion ({motion.duration:.3g} s, recorded torque and soft PD)",
        ("joint", "torque RMSE", "motion RMSE [rad]", "largest [rad]"),
        zip(result.joints, consistent.validation.rmse, motion.position_rmse, motion.max_position_error, strict=True),
    )


def print_verdict(verdict: Verdict) -> None:
    """Headline, purposes, joints that are not good, checks."""
    for line in verdict.lines:
        print(line)


def _print_merge(merge: Merge) -> None:
    print_table(
        "\nModels that were merged",
        ("model", "method", "values", "locked", "torques of"),
        [
            (
                model.file,
                model.method,
                model.parameters,
                "; ".join(dict.fromkeys(", ".join(experiment.locked) or "none" for experiment in model.experiments)),
                "; ".join(dict.fromkeys(", ".join(experiment.torques_of) for experiment in model.experiments)),
            )
            for model in merge.models
        ],
    )
    if merge.consistency is not None and merge.consistency.contradictions:
        print_table(
            "\nValues that differ significantly from the merged model",
            ("parameter", "of", "value", "merged", "difference [σ]"),
            [
                (value.parameter, value.file, value.value, value.merged, value.deviations)
                for value in merge.consistency.contradictions
            ],
        )


def print_fit(title: str, joints: Sequence[str], fit: Fit) -> None:
    """Errors of each joint."""
    print(f"{title}: relative error {percent_text(fit.relative_error)} over {fit.samples} filtered samples")
    print_table(
        "",
        ("joint", "RMSE", "at low speed", "at high speed", "largest", "relative [%]"),
        zip(
            joints,
            fit.rmse,
            fit.low_speed_rmse,
            fit.high_speed_rmse,
            fit.max_error,
            map(in_percent, fit.joint_relative_error),
            strict=True,
        ),
    )
