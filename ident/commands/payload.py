"""The commands `dynid payload` and `dynid gains`: a run without and a run with a load."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import typer

if TYPE_CHECKING:
    from daq.recording.recording import Recording
    from daq.robot.loader import RobotFile
    from ident.experiments.drive_gains import DriveGains
    from ident.experiments.payload import Payload
    from ident.experiments.up_and_down import SlowGains
    from ident.model.load import KnownLoad

Known = TypeVar("Known")
Found = TypeVar("Found")

app = typer.Typer()

FREE = typer.Argument(help="Recording (.h5) of the arm without the load.")
LOADED = typer.Argument(help="Recording (.h5) of the same arm with it.")
MASS = typer.Option(None, "--mass", help="Mass of the load [kg].")
COM = typer.Option(None, "--com", help="Its centre of mass X,Y,Z in the tool frame [m].")
INERTIA = typer.Option(None, "--inertia", help="Its inertia XX,XY,XZ,YY,YZ,ZZ about the centre of mass [kg·m²].")
ROBOT = typer.Option(None, "--robot", help="Robot file in place of the free recording's own.")
DELAY = typer.Option("auto", "--delay", help="Delay of torque behind position: auto, or SECONDS.")
UP_AND_DOWN = typer.Option(False, "--up-and-down", help="From slow passes of one joint at a time, up and down.")
JSON = typer.Option(False, "--json", help="One JSON object on standard output, nothing else there.")


@app.command("payload")
def payload(
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
    from daq.commands.console import print_json
    from drivers.errors import UsageError
    from ident.experiments.payload import identify_payload
    from ident.experiments.payload_summary import payload_result

    if mass is None and (com is not None or inertia is not None):
        raise UsageError("--com and --inertia describe a load whose mass is missing", hint="add --mass KG")
    known = None if mass is None else _known_load(mass, com, inertia)
    found = _identified("payload", identify_payload, (free, loaded), known, robot, delay, quiet=as_json)
    if as_json:
        print_json(payload_result(found).model_dump())
    else:
        print_payload(found)


@app.command("gains")
def gains(
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
    from daq.commands.console import print_json
    from drivers.errors import UsageError
    from ident.experiments.drive_gains import identify_gains
    from ident.experiments.payload_summary import gains_result, slow_gains_result
    from ident.experiments.up_and_down import identify_slow_gains

    if mass is None:
        raise UsageError(
            "the gains are not identifiable without the load's mass: twice the gains with twice the masses fit equally "
            "well",
            hint="weigh the load and add --mass KG",
        )
    known = _known_load(mass, com, inertia)
    if up_and_down:
        slow = _identified("gains", identify_slow_gains, (free, loaded), known, robot, delay, quiet=as_json)
        if as_json:
            print_json(slow_gains_result(slow).model_dump())
        else:
            print_slow_gains(slow)
        return
    found = _identified("gains", identify_gains, (free, loaded), known, robot, delay, quiet=as_json)
    if as_json:
        print_json(gains_result(found).model_dump())
    else:
        print_gains(found)


def print_payload(found: Payload) -> None:
    """The load as a person reads it at the terminal."""
    from daq.commands.console import print_table
    from ident.experiments.payload_summary import FRAME_TEXT, base_changes, load_parameters, payload_sentences
    from ident.regression.hypothesis_tests import WITHIN_95_PERCENT

    print(f"delay: {found.pair.delay_note}\n{FRAME_TEXT}")
    for estimate, title in ((found.load, "Load"), (found.with_mass, "Load with the known parameters held fixed")):
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
            for row in base_changes(found)
        ],
    )
    print()
    for sentence in payload_sentences(found):
        print(sentence)
    for warning in found.warnings:
        print(f"warning: {warning}")


def print_gains(found: DriveGains) -> None:
    """The gains as a person reads them at the terminal."""
    from daq.commands.console import print_table
    from ident.experiments.payload_summary import base_unit, drives_text, gain_unit

    print(f"delay: {found.pair.delay_note}")
    print_table(
        f"\nDrive gains [{gain_unit(found.signal)}], joint side",
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
            for gain in found.gains
        ],
    )
    pair = found.pair
    print_table(
        "\nBase parameters with these gains; σ includes that of the gains",
        ("name", "value", "σ", "unit"),
        [
            (
                pair.base.names[i],
                float(found.parameters[i]),
                float(found.parameter_std[i]),
                base_unit(pair.model, pair.base.columns[i]),
            )
            for i in found.active
        ],
    )
    print(f"\nsingular values: condition {found.condition:.3g}, null vector {found.gap:.3g} times below the next")
    print(f"\nfor the robot file:\n{drives_text(found)}")
    for warning in found.warnings:
        print(f"warning: {warning}")


def print_slow_gains(found: SlowGains) -> None:
    """Gains from slow up-and-down runs as a person reads them at the terminal."""
    from daq.commands.console import print_table
    from ident.experiments.payload_summary import drives_text, gain_unit
    from ident.regression.hypothesis_tests import WITHIN_95_PERCENT

    print_table(
        f"\nDrive gains [{gain_unit(found.signal)}], joint side, by half sums of slow runs up and down",
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
            for gain in found.gains
        ],
    )
    print_table(
        "\nFriction at that speed [N·m], by half differences and these gains",
        ("joint", "free", "loaded"),
        [(gain.joint, gain.free_friction, gain.loaded_friction) for gain in found.gains],
    )
    if found.known.com is None:
        centre = ", ".join(
            f"{value / found.known.mass:.4g} ± {WITHIN_95_PERCENT * std / found.known.mass:.1g}"
            for value, std in zip(found.moments, found.moments_std, strict=True)
        )
        print(f"\ncentre of mass [m]: {centre}; null vector {found.gap:.3g} times below the next")
    print(f"\nfor the robot file:\n{drives_text(found)}")
    for warning in found.warnings:
        print(f"warning: {warning}")


def _identified(
    what: str,
    identify: Callable[[Recording, Recording, Known, RobotFile | None, float | None], Found],
    runs: tuple[Path, Path],
    known: Known,
    robot: str | None,
    delay: str,
    *,
    quiet: bool,
) -> Found:
    """What `identify` finds in the free and the loaded run."""
    from daq.commands.console import progress_line
    from daq.recording.reader import read_recording
    from daq.robot.loader import load_robot
    from ident.commands.option_text import delay_option

    free, loaded = (read_recording(path) for path in runs)
    robot_file = load_robot(robot) if robot else None
    with progress_line(quiet=quiet) as progress:
        progress(what)
        return identify(free, loaded, known, robot_file, delay_option(delay))


def _known_load(mass: float, com: str | None, inertia: str | None) -> KnownLoad:
    from ident.model.load import KnownLoad

    return KnownLoad(mass, _numbers(com, "--com"), _numbers(inertia, "--inertia"))


def _numbers(text: str | None, option: str) -> tuple[float, ...] | None:
    from drivers.errors import UsageError

    if text is None:
        return None
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise UsageError(f"'{text}' are not numbers separated by commas", where=option) from None
