"""The commands `dynid payload` and `dynid gains`: a run without and a run with a load."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from ident.commands.options import DELAY, JSON

if TYPE_CHECKING:
    from ident.experiments.drive_gains import DriveGains
    from ident.experiments.payload import Payload
    from ident.experiments.up_and_down import SlowGains

app = typer.Typer()

FREE = typer.Argument(help="Recording (.h5) of the arm without the load.")
LOADED = typer.Argument(help="Recording (.h5) of the same arm with it.")
MASS = typer.Option(None, "--mass", help="Mass of the load [kg].")
COM = typer.Option(None, "--com", help="Its centre of mass X,Y,Z in the tool frame [m].")
INERTIA = typer.Option(None, "--inertia", help="Its inertia XX,XY,XZ,YY,YZ,ZZ about the centre of mass [kg·m²].")
ROBOT = typer.Option(None, "--robot", help="Robot file in place of the free recording's own.")
UP_AND_DOWN = typer.Option(False, "--up-and-down", help="From slow passes of one joint at a time, up and down.")


@app.command("payload")
def identify_load(
    free: Path = FREE,
    loaded: Path = LOADED,
    mass: float = MASS,
    com: str = COM,
    inertia: str = INERTIA,
    robot: str = ROBOT,
    delay: str = DELAY,
    as_json: bool = JSON,
) -> None:
    """Identify the load on the tool, and test whether a load explains what changed between the runs.

    Example: dynid payload free.h5 loaded.h5 --mass 2.8
    """
    from daq.commands.console import progress_line
    from ident.commands.options import delay_option, numbers_option
    from ident.tasks.loads import payload

    com_values, inertia_values = numbers_option(com, "--com"), numbers_option(inertia, "--inertia")
    with progress_line(quiet=as_json) as progress:
        progress("payload")
        load = payload(
            free, loaded, mass=mass, com=com_values, inertia=inertia_values, robot=robot, delay=delay_option(delay)
        )
    if as_json:
        print(load.to_json())
    else:
        print_payload(load.estimate)


@app.command("gains")
def identify_drive_gains(
    free: Path = FREE,
    loaded: Path = LOADED,
    mass: float = MASS,
    com: str = COM,
    inertia: str = INERTIA,
    robot: str = ROBOT,
    delay: str = DELAY,
    up_and_down: bool = UP_AND_DOWN,
    as_json: bool = JSON,
) -> None:
    """Identify the gains of all drives from a run without and a run with a load of known mass.

    Example: dynid gains free.h5 loaded.h5 --mass 2.8
    """
    from daq.commands.console import progress_line
    from drivers.errors import UsageError
    from ident.commands.options import delay_option, numbers_option
    from ident.experiments.drive_gains import DriveGains
    from ident.tasks.loads import drive_gains

    if mass is None:
        raise UsageError(
            "the gains are not identifiable without the load's mass: twice the gains with twice the masses fit equally "
            "well",
            hint="weigh the load and add --mass KG",
        )
    com_values, inertia_values = numbers_option(com, "--com"), numbers_option(inertia, "--inertia")
    with progress_line(quiet=as_json) as progress:
        progress("gains")
        identified = drive_gains(
            free,
            loaded,
            mass=mass,
            com=com_values,
            inertia=inertia_values,
            robot=robot,
            delay=delay_option(delay),
            up_and_down=up_and_down,
        )
    if as_json:
        print(identified.to_json())
    elif isinstance(identified.estimate, DriveGains):
        print_gains(identified.estimate)
    else:
        print_slow_gains(identified.estimate)


def print_payload(payload: Payload) -> None:
    """The load as a person reads it at the terminal."""
    from daq.commands.console import print_table
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
    from ident.experiments.payload_summary import base_unit, drives_text, gain_unit

    print(f"delay: {gains.pair.delay_note}")
    print_table(
        f"\nDrive gains [{gain_unit(gains.signal)}], joint side",
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
                base_unit(pair.model, pair.base.columns[i]),
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
    from ident.experiments.payload_summary import drives_text, gain_unit
    from ident.regression.hypothesis_tests import WITHIN_95_PERCENT

    print_table(
        f"\nDrive gains [{gain_unit(gains.signal)}], joint side, by half sums of slow runs up and down",
        ("joint", "robot file", "identified", "σ", "RSD [%]", "change [%]", "poses", "positions", "speed [rad/s]"),
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
        "\nFriction at that speed [N·m], by half differences and these gains",
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
