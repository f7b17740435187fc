"""Results and their tables at the terminal."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

from daq.commands.console import print_json, print_table
from daq.output_files import REPORT_FILE
from drivers.core.text import percent_text
from ident.assessment.validation import Fit
from ident.commands.printing.verdict import next_steps, print_everything, print_next, print_purposes
from ident.identify.data_split import labelled
from ident.result.delivered import DELIVERED_WORDS
from ident.result.schema import Result
from ident.result.tables import Table
from ident.tasks.arguments import GradedResult
from ident.verdict.verdict import Verdict
from ident.views.result_tables import (
    error_table,
    friction_step_table,
    joint_friction_table,
    merge_tables,
    parameter_table,
    result_errors,
)


def print_tables(tables: Iterable[Table]) -> None:
    """Print tables on standard output, each with its title and its note; those without rows are left out."""
    for table in tables:
        if len(table):
            headings = [column.heading for column in table.columns]
            title = f"\n{table.title}" if table.title else ""
            print_table(title, headings, zip(*(column.texts for column in table.columns), strict=True))
            if table.note:
                print(table.note)


def print_result(result: Result, report: Path, *, verbose: bool = False) -> None:
    """The result as a person reads it: the verdict first, with `verbose` all that was computed after it."""
    verdict = result.verdict
    significant = sum(parameter.significant for parameter in result.base_parameters)
    count = len(result.base_parameters)
    print(f"{result.robot}, {result.method}: {significant} of {count} base parameters are significant")
    print(verdict.grades)
    print_purposes(verdict)
    for run in result.delivered.runs:
        error = percent_text(run.all_samples.relative_error, 2)
        print(f"{labelled(run.recording, run.overlap)}: torque error {error}")
    _print_worst_joint(verdict)
    if result.acceptance is not None:
        print(result.acceptance)
    use = f"dynid validate {report.parent} other.h5, dynid predict {report.parent} run.h5, dynid export {report.parent}"
    print_next(next_steps(verdict, use), verdict, f"All figures: {report}, or --verbose.")
    if verbose:
        print()
        _print_details(result)


def _print_worst_joint(verdict: Verdict) -> None:
    worst = verdict.joints[0] if verdict.joints else None
    if worst is not None and worst.grade != "good":
        print(f"Worst joint: {worst.joint}, {worst.grade}, because {worst.because}.")


def _print_details(result: Result) -> None:
    """All that was computed, as far as a terminal can show it."""
    for step in result.preprocessing:
        print(f"{step.name}: {step.text}")
    print(f"delay: {result.delay.note}")
    if result.merge is not None:
        print_tables(merge_tables(result.merge))
    print_tables([parameter_table(result).pick("name", "value", "std", "rsd", "f_value", "significant", "unit")])
    if any(joint.terms_text or joint.repeatability_text for joint in result.friction):
        print_tables([joint_friction_table(result)])
    elif result.friction_note:
        print(f"\n{result.friction_note}")
    print_tables([friction_step_table(result)])
    _print_errors(result)
    _print_simulation(result)
    print(
        f"\ncondition number {result.excitation.condition:.4g}, "
        f"column-normalised {result.excitation.scaled_condition:.4g}"
    )
    print_everything(result.verdict)


def _print_errors(result: Result) -> None:
    """Errors of the model that is handed out by default."""
    delivered, moving = result.delivered, result.delivered.validation
    held_out = "" if moving is None or moving.held_out else ", NOT HELD OUT"
    held = (f"validation_{error}" for error in ("rmse", "low_speed_rmse", "high_speed_rmse", "relative_error"))
    table = result_errors(result).pick("joint", "fit_rmse", *held, "in_motion_relative_error")
    print_tables([replace(table, title=f"Errors of the {DELIVERED_WORDS[delivered.parameters]} model{held_out}")])


def _print_simulation(result: Result) -> None:
    """Motion errors of the simulated arm, without a controller beside constant velocity, and with a soft one."""
    for run in result.delivered.runs:
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


def print_fit(title: str, joints: Sequence[str], unit: str, fit: Fit) -> None:
    """Errors of each joint, in a unit."""
    print(f"{title}: relative error {percent_text(fit.relative_error)} over {fit.samples} filtered samples")
    print_tables([error_table("", joints, unit, {"": fit})])


def print_identified(model: GradedResult, folder: Path, use: str, *, verbose: bool) -> None:
    """The verdict and the errors; with `verbose` every parameter."""
    print(model.verdict)
    print_tables([model.errors, *([model.parameters] if verbose else [])])
    print(f"\n{'' if verbose else 'Parameters with intervals: --verbose, or the report. '}{folder / REPORT_FILE}")
    print(f"next: {use}")


def print_validated(model: GradedResult, path: Path, errors: Table, *, as_json: bool) -> None:
    """The verdict on other recordings, and the errors; or both as a JSON object."""
    result = model.result
    if as_json:
        assert result.validation is not None
        print_json(
            {"result": path, "joints": result.joints, "validation": result.validation, "verdict": result.verdict}
        )
        return
    print(model.verdict)
    print_tables([errors])
