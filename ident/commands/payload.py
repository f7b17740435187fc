"""The commands `dynid payload` and `dynid gains`: a run without and a run with a load."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from ident.commands.options import FORCE, JSON, takes
from ident.tasks.options import GainsOptions, LoadOptions

if TYPE_CHECKING:
    from ident.experiments.gains.drive_gains import DriveGains
    from ident.experiments.gains.up_and_down import SlowGains
    from ident.experiments.load.payload import Payload

app = typer.Typer()

OUT = typer.Option(None, "-o", "--out", help="Folder for the result (.json) and report.html.")


def _folder(options: LoadOptions, out: Path | None, experiment: str, result: str, *, overwrite: bool) -> Path:
    """The folder for the results, checked: `--out`, or the loaded recording's name and what the experiment is.

    Raises:
        UsageError: its files exist already, or cannot be written.
    """
    from daq.output_files import REPORT_FILE, check_output_folder
    from daq.robot.loader import load_robot
    from ident.tasks.runs import paths_of

    free, loaded = paths_of(options.free, options.loaded)
    folder = out if out is not None else Path(f"{loaded.stem}-{experiment}")
    inputs = [free, loaded, *(load_robot(options.robot).files if options.robot else ())]
    check_output_folder(folder, (result, REPORT_FILE), inputs, overwrite=overwrite)
    return folder


@app.command("payload")
@takes(LoadOptions)
def identify_load(*, options: LoadOptions, out: Path = OUT, force: bool = FORCE, as_json: bool = JSON) -> None:
    """Identify the load on the tool, and test whether a load explains what changed between the runs.

    Example: dynid payload free.h5 loaded.h5 --mass 2.8 -o load
    """
    from daq.commands.console import progress_line
    from daq.output_files import REPORT_FILE
    from ident.tasks.loads import PAYLOAD_FILE, payload

    folder = _folder(options, out, "payload", PAYLOAD_FILE, overwrite=force)
    with progress_line(quiet=as_json) as progress:
        progress("payload")
        load = payload(**vars(options))
        progress("report")
        load.save(folder)
    if as_json:
        print(load.to_json())
        return
    print_payload(load.estimate)
    print(f"\n{folder / PAYLOAD_FILE}\n{folder / REPORT_FILE}")


@app.command("gains")
@takes(GainsOptions)
def identify_drive_gains(*, options: GainsOptions, out: Path = OUT, force: bool = FORCE, as_json: bool = JSON) -> None:
    """Identify the gains of all drives from a run without and a run with a load of known mass.

    Example: dynid gains free.h5 loaded.h5 --mass 2.8 -o gains
    """
    from daq.commands.console import progress_line
    from daq.output_files import REPORT_FILE
    from ident.experiments.gains.drive_gains import DriveGains
    from ident.tasks.loads import GAINS_FILE, drive_gains

    folder = _folder(options, out, "gains", GAINS_FILE, overwrite=force)
    with progress_line(quiet=as_json) as progress:
        progress("gains")
        identified = drive_gains(**vars(options))
        progress("report")
        identified.save(folder)
    if as_json:
        print(identified.to_json())
        return
    if isinstance(identified.estimate, DriveGains):
        print_gains(identified.estimate)
    else:
        print_slow_gains(identified.estimate)
    print(f"\n{folder / GAINS_FILE}\n{folder / REPORT_FILE}")


def print_payload(payload: Payload) -> None:
    """The load as a person reads it at the terminal."""
    from daq.commands.console import print_table
    from ident.experiments.load.consistent_load_summary import (
        consistent_load_result,
        consistent_load_rows,
        consistent_load_sentences,
    )
    from ident.experiments.payload_summary import FRAME_TEXT, base_changes, load_parameters, payload_sentences
    from ident.regression.hypothesis_tests import WITHIN_95_PERCENT

    print(f"delay: {payload.pair.delay_note}\n{FRAME_TEXT}")
    for estimate, title in ((payload.load, "Load"), (payload.with_mass, "Load with the known parameters held fixed")):
        if estimate is None:
            continue
        print_table(
            f"\n{title}",
            ("name", "value", "σ", "σ by noise", "σ by gains", "unit", "expression"),
            [
                (row.name, row.value, row.std, row.noise_std, row.gain_std, row.unit, row.expression)
                for row in load_parameters(estimate)
            ],
        )
        if estimate.centre is not None:
            values = ", ".join(
                f"{value:.4g} ± {WITHIN_95_PERCENT * std:.1g}" for value, std in zip(*estimate.centre, strict=True)
            )
            print(f"centre of mass [m]: {values}")
        if estimate.columns.no_effect:
            print(f"without effect on this arm: {', '.join(estimate.columns.no_effect)}")
    if payload.consistent is not None:
        body = consistent_load_result(payload.pair, payload.consistent)
        print_table(
            "\nLoad as a body that can exist: centre of mass, and inertia about it",
            ("name", "value", "σ", "unit", "from"),
            consistent_load_rows(body),
        )
        for sentence in consistent_load_sentences(body):
            print(sentence)
    print_table(
        "\nBase parameters that a load changes",
        ("name", "free", "σ", "free plus load", "identified loaded", "σ", "unit"),
        [
            (row.name, row.free, row.free_std, row.predicted, row.loaded, row.loaded_std, row.unit)
            for row in base_changes(payload)
        ],
    )
    print()
    for sentence in payload_sentences(payload):
        print(sentence)
    for warning in payload.warnings:
        print(f"warning: {warning}")


def print_gains(gains: DriveGains) -> None:
    """The gains as a person reads them at the terminal."""
    from daq.commands.console import print_table
    from ident.experiments.payload_summary import drives_text, gain_unit
    from ident.result.units import parameter_unit

    print(f"delay: {gains.pair.delay_note}")
    print_table(
        f"\nDrive gains [{gain_unit(gains.signal, gains.robot)}], joint side",
        (
            "joint",
            "robot file",
            "identified",
            "σ",
            "RSD [%]",
            "change [%]",
            "angle [°]",
            "confounded with",
            "correlation",
        ),
        [
            (
                gain.joint,
                gain.file_gain,
                gain.gain,
                gain.std,
                gain.relative_std,
                100.0 * (gain.gain / gain.file_gain - 1.0) if gain.file_gain else None,
                gain.angle,
                *gain.confused_with,
            )
            for gain in gains.gains
        ],
    )
    pair = gains.pair
    print_table(
        "\nBase parameters with these gains; σ includes that of the gains",
        ("name", "value", "σ", "unit"),
        [
            (
                pair.base.names[i],
                float(gains.parameters[i]),
                float(gains.parameter_std[i]),
                parameter_unit(pair.model, pair.base.columns[i]),
            )
            for i in gains.active
        ],
    )
    print(f"\nsingular values: condition {gains.condition:.3g}, null vector {gains.gap:.3g} times below the next")
    print(f"\nfor the robot file:\n{drives_text(gains)}")
    for warning in gains.warnings:
        print(f"warning: {warning}")


def print_slow_gains(gains: SlowGains) -> None:
    """Gains from slow up-and-down runs as a person reads them at the terminal."""
    from daq.commands.console import print_table
    from drivers.core.units import common_unit
    from ident.experiments.payload_summary import drives_text, gain_unit
    from ident.regression.hypothesis_tests import WITHIN_95_PERCENT

    speed, torque = (common_unit(unit, gains.robot.sliding) for unit in ("rad/s", "N·m"))
    print_table(
        f"\nDrive gains [{gain_unit(gains.signal, gains.robot)}], joint side, by half sums of slow runs up and down",
        ("joint", "robot file", "identified", "σ", "RSD [%]", "change [%]", "poses", "positions", f"speed [{speed}]"),
        [
            (
                gain.joint,
                gain.file_gain,
                gain.gain,
                gain.std,
                gain.relative_std,
                100.0 * (gain.gain / gain.file_gain - 1.0) if gain.file_gain else None,
                gain.sweeps,
                gain.bins,
                gain.speed,
            )
            for gain in gains.gains
        ],
    )
    print_table(
        f"\nFriction at that speed [{torque}], by half differences and these gains",
        ("joint", "free", "loaded"),
        [(gain.joint, gain.free_friction, gain.loaded_friction) for gain in gains.gains],
    )
    if gains.known.com is None:
        centre = ", ".join(
            f"{value / gains.known.mass:.4g} ± {WITHIN_95_PERCENT * std / gains.known.mass:.1g}"
            for value, std in zip(gains.moments, gains.moments_std, strict=True)
        )
        print(f"\ncentre of mass [m]: {centre}; null vector {gains.gap:.3g} times below the next")
    print(f"\nfor the robot file:\n{drives_text(gains)}")
    for warning in gains.warnings:
        print(f"warning: {warning}")
