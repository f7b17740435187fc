"""The commands `dynid payload` and `dynid gains`: a run without and a run with a load."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from daq.commands.help_text import CommandApp
from daq.commands.options import FORCE, JSON, VERBOSE, folder_option, takes
from ident.tasks.options import GainsOptions, LoadOptions

if TYPE_CHECKING:
    from ident.experiments.gains.drive_gains import DriveGains
    from ident.experiments.gains.up_and_down import SlowGainsResult
    from ident.experiments.load.payload import Payload

app = CommandApp("Identify")


@app.command("payload")
@takes(LoadOptions)
def identify_load(
    *,
    options: LoadOptions,
    out: Path = folder_option("payload.json"),
    verbose: bool = VERBOSE,
    force: bool = FORCE,
    as_json: bool = JSON,
) -> None:
    """Identify the load on the tool from runs without and with it.

    Example: dynid payload free.h5 loaded.h5 --mass 2.8 -o load
    """
    from ident.commands.saving import check_result_folder, print_files, save_result
    from ident.tasks.arguments import paths_of
    from ident.tasks.loads import PAYLOAD_FILE, payload

    runs = paths_of(options.free, options.loaded)
    folder = out if out is not None else Path(f"{runs[-1].stem}-payload")
    check_result_folder(folder, PAYLOAD_FILE, runs, options.robot, overwrite=force)
    load = save_result(lambda _: payload(**vars(options)), folder, "payload", overwrite=force, as_json=as_json)
    if as_json:
        print(load.to_json())
        return
    _print_load(load.result, verbose=verbose)
    print_files(folder, PAYLOAD_FILE)


@app.command("gains")
@takes(GainsOptions)
def identify_drive_gains(
    *,
    options: GainsOptions,
    out: Path = folder_option("gains.json"),
    verbose: bool = VERBOSE,
    force: bool = FORCE,
    as_json: bool = JSON,
) -> None:
    """Identify drive gains from runs without and with a known load.

    Example: dynid gains free.h5 loaded.h5 --mass 2.8 -o gains
    """
    from ident.commands.saving import check_result_folder, print_files, save_result
    from ident.tasks.arguments import paths_of
    from ident.tasks.loads import GAINS_FILE, drive_gains

    runs = paths_of(options.free, options.loaded)
    folder = out if out is not None else Path(f"{runs[-1].stem}-gains")
    check_result_folder(folder, GAINS_FILE, runs, options.robot, overwrite=force)
    identified = save_result(lambda _: drive_gains(**vars(options)), folder, "gains", overwrite=force, as_json=as_json)
    if as_json:
        print(identified.to_json())
        return
    _print_gains(identified.result, verbose=verbose)
    print_files(folder, GAINS_FILE)


def _print_load(result: Payload, *, verbose: bool) -> None:
    """The load as a body, or its parameters, and the warnings; with `verbose` every table and test."""
    from ident.commands.printing.result import print_tables
    from ident.views.load_tables import body_table, load_table, payload_tables

    body, warnings = result.consistent_load, [f"warning: {warning}" for warning in result.warnings]
    if not verbose:
        print_tables([replace(load_table(result.load) if body is None else body_table(body), title="")])
        print("\n".join([*warnings, "Parameters and tests: --verbose, or the report."]))
        return
    print(f"delay: {result.delay.note}\n{result.frame}")
    print_tables(payload_tables(result))
    sentences = [*(() if body is None else body.sentences), *result.sentences]
    print("\n".join(["", *sentences, *warnings]))


def _print_gains(result: DriveGains | SlowGainsResult, *, verbose: bool) -> None:
    """The gains and the text for the robot file; with `verbose` the parameters that were identified with them."""
    from ident.commands.printing.result import print_tables
    from ident.experiments.gains.drive_gains import DriveGains
    from ident.views.load_tables import gains_tables

    condition, tables = "", gains_tables(result)
    if verbose and isinstance(result, DriveGains):
        print(f"delay: {result.delay.note}")
        condition = f"condition {result.condition:.3g}, "
    print_tables(tables if verbose else [replace(tables[0], title="")])
    if verbose and result.gap is not None:  # one gain, or each separately: no null vector
        print(f"\nsingular values: {condition}null vector {result.gap:.3g} times below the next")
    print("\n" * verbose + f"for the robot file:\n{result.robot_file_text}")
    for warning in result.warnings:
        print(f"warning: {warning}")
