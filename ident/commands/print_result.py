"""Results and their tables at the terminal."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from daq.commands.console import print_table
from drivers.core.text import in_percent, percent_text
from ident.assessment.validation import Fit
from ident.result.delivered import DELIVERED_WORDS
from ident.result.schema import Merge, Result
from ident.result.tables import Table
from ident.verdict.verdict import Verdict


def print_tables(tables: Iterable[Table]) -> None:
    """Print tables on standard output, each with its title and its note; those without rows are left out."""
    for table in tables:
        if len(table):
            headings = [column.heading for column in table.columns]
            print_table(f"\n{table.title}", headings, zip(*(column.texts for column in table.columns), strict=True))
            if table.note:
                print(table.note)


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
    _print_errors(result)
    _print_simulation(result)
    print(
        f"\ncondition number {result.excitation.condition:.4g}, "
        f"column-normalised {result.excitation.scaled_condition:.4g}"
    )
    print_verdict(result.verdict)
    if result.acceptance is not None:
        print(f"\n{result.acceptance}")


def _print_friction(result: Result) -> None:
    """What friction's intervals hold, further terms of the joints that have some, and the steps that led there."""
    repeated = [p for p in result.base_parameters if p.repeatability is not None]
    if repeated:
        print_table(
            "\nFriction between runs",
            ("name", "value", "σ of the mean", "repeatability σ", "unit"),
            [(p.name, p.value, p.std, p.repeatability, p.unit) for p in repeated],
        )
    if result.friction_note:
        print(f"\n{result.friction_note}")
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


def _print_errors(result: Result) -> None:
    """Errors of the model that is handed out by default."""
    delivered = result.delivered
    if delivered is None:
        return
    fit, moving, every = delivered.fit, delivered.validation, delivered.validation_all_samples
    held_out = "" if moving is None or moving.held_out else ", NOT HELD OUT"
    print_table(
        f"\nErrors of the {DELIVERED_WORDS[delivered.parameters]} model [{result.unit('N·m')}]{held_out}",
        ("joint", "RMSE fit", "RMSE validation", "at low speed", "at high speed", "relative [%]", "in motion [%]"),
        [
            (
                joint,
                fit.rmse[i] if fit else None,
                every.rmse[i] if every else None,
                every.low_speed_rmse[i] if every else None,
                every.high_speed_rmse[i] if every else None,
                in_percent(every.joint_relative_error[i]) if every else None,
                in_percent(moving.joint_relative_error[i]) if moving else None,
            )
            for i, joint in enumerate(result.joints)
        ],
    )


def _print_simulation(result: Result) -> None:
    """Motion errors of the simulated arm, without a controller beside constant velocity, and with a soft one."""
    for run in [] if result.delivered is None else result.delivered.runs:
        driven, tracked = run.open_loop, run.simulation
        if driven is None or tracked is None:
            print(f"\nnot simulated on {run.recording}: {run.not_simulated or 'no window of motion is long enough'}")
            continue
        print_table(
            f"\nSimulated motion on {run.recording}: {driven.windows} windows of {driven.window:.3g} s by recorded "
            f"torque alone, and {tracked.duration:.3g} s with a soft PD controller; RMSE "
            f"[{result.unit('rad')}]",
            ("joint", "without controller", "constant velocity", "ratio", "with controller", "largest"),
            zip(
                result.joints,
                driven.position_rmse,
                driven.reference_rmse,
                driven.joint_ratio,
                tracked.position_rmse,
                tracked.max_position_error,
                strict=True,
            ),
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


def print_fit(title: str, joints: Sequence[str], unit: str, fit: Fit) -> None:
    """Errors of each joint, in a unit."""
    print(f"{title}: relative error {percent_text(fit.relative_error)} over {fit.samples} filtered samples")
    print_table(
        f"Errors [{unit}]",
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
