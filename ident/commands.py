"""Commands of the identification side: `robot show`, `check`, `info`, `identify`, `validate`, `merge`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from ident.merge_commands import merge_app

if TYPE_CHECKING:
    from daq.robot import RobotFile

app = typer.Typer()
robot_app = typer.Typer(no_args_is_help=True, help="What a robot file says and what its arm can reveal.")
app.add_typer(robot_app, name="robot")
app.add_typer(merge_app)

JSON = typer.Option(False, "--json", help="One JSON object on standard output, nothing else there.")
ROBOT = typer.Argument(help="Built-in robot or robot file.")


@robot_app.command("show")
def show(
    robot: str = ROBOT, as_yaml: bool = typer.Option(False, "--yaml", help="The file itself."), as_json: bool = JSON
) -> None:
    """Show joints, limits and base parameters with their expressions.

    Example: dynid robot show ur5e
    """
    from daq.console import print_json, print_table
    from daq.robot import load_robot
    from ident.base_parameters import base_parameters
    from ident.model import build_model
    from ident.symbols import symbolic_expressions

    robot_file = load_robot(robot)
    if as_yaml:
        print(robot_file.text, end="")
        return
    if as_json:
        print_json(_description(robot_file))
        return
    model = build_model(robot_file)
    base = base_parameters(model)
    expressions = symbolic_expressions(robot_file, model, base)
    described = robot_file.robot
    print(f"{described.name}: {described.description}".rstrip(": "))
    print_table(
        "Joints",
        ("joint", "position", "velocity", "acceleration", "torque", "gain", "signal"),
        [
            (
                joint.name,
                f"{joint.position[0]:.4g} … {joint.position[1]:.4g}",
                joint.velocity,
                joint.acceleration,
                joint.torque,
                described.drive(joint.name).gain,
                described.drive(joint.name).signal,
            )
            for joint in described.joints
        ],
    )
    print_table(
        f"\nBase parameters: {base.count}, {_inertial_count(robot_file)} of them inertial",
        ("name", "kind", "expression"),
        zip(base.names, (kind.replace("_", " ") for kind in base.kinds), expressions, strict=True),
    )
    print(f"\nwithout effect: {', '.join(base.no_effect) or 'none'}")
    print(f"rank decided with a margin of {base.margin:.1e} between singular values")
    for section, source in described.sources.items():
        print(f"source of {section}: {source}")


def _description(robot_file: RobotFile) -> dict[str, Any]:
    from ident.base_parameters import base_parameters
    from ident.model import build_model
    from ident.symbols import symbolic_expressions

    robot, model = robot_file.robot, build_model(robot_file)
    base = base_parameters(model)
    expressions = symbolic_expressions(robot_file, model, base)
    return {
        "name": robot.name,
        "description": robot.description,
        "dof": robot.dof,
        "joints": [joint.model_dump(mode="json") for joint in robot.joints],
        "base_parameters": [
            {"name": name, "expression": expression, "kind": kind}
            for name, expression, kind in zip(base.names, expressions, base.kinds, strict=True)
        ],
        "inertial_base_count": _inertial_count(robot_file),
        "base_count": base.count,
        "no_effect": list(base.no_effect),
        "rank_margin": base.margin,
        "sources": robot.sources,
    }


def _inertial_count(robot_file: RobotFile) -> int:
    """Number of inertial base parameters, motor inertia left out of the model."""
    from dataclasses import replace

    from ident.base_parameters import base_parameters
    from ident.model import build_model

    model = build_model(robot_file)
    bare = base_parameters(replace(model, motor_inertia=(False,) * model.dof))
    return sum(kind == "inertial" for kind in bare.kinds)


@app.command("check")
def check(
    robot: str = ROBOT,
    connect: bool = typer.Option(False, "--connect", help="Open the connection and listen; nothing is enabled."),
    wire: str = typer.Option(None, "--wire", help="Connection to open; the first one if absent."),
    host: str = typer.Option(None, "--host", help="Address in place of the connection's own."),
    as_json: bool = JSON,
) -> None:
    """Validate a robot file: its keys, kinematics, base parameters, connections and how full their CAN buses will be.

    Example: dynid check my_arm.yaml --connect
    """
    from dataclasses import asdict

    from daq.console import print_json
    from daq.robot import load_robot
    from drivers.clock import SYSTEM_CLOCK
    from drivers.errors import UsageError
    from ident.connection_check import check_connections, print_connection
    from ident.robot_check import budget_object, bus_budgets, check_robot, print_budget

    if not connect and (wire is not None or host is not None):
        raise UsageError("--wire and --host say what --connect opens", hint="add --connect")
    robot_file = load_robot(robot)
    findings = check_robot(robot_file)
    budgets = bus_budgets(robot_file)
    name = robot_file.robot.name
    if not as_json:
        print(f"{name}: the file is valid, {robot_file.robot.dof} joints")
        for connection, budget in budgets.items():
            print_budget(connection, budget)
        for finding in findings:
            print(f"  warning: {finding}")
    found = check_connections(robot_file, wire, host, SYSTEM_CLOCK) if connect else []
    if not as_json:
        for answered in found:
            print_connection(answered)
        return
    content = {"robot": name, "ok": True, "warnings": findings, **_description(robot_file)}
    content["budgets"] = {connection: budget_object(budget) for connection, budget in budgets.items()}
    if connect:
        content["connections"] = [asdict(answered) for answered in found]
    print_json(content)


@app.command("info")
def info(
    recording: Path = typer.Argument(help="Recording (.h5)."),
    robot: str = typer.Option(None, "--robot", help="Robot file in place of the recording's own."),
    wanted_rsd: float = typer.Option(
        None, "--wanted-rsd", help="Tell how long this motion must last for this relative standard deviation [%]."
    ),
    as_json: bool = JSON,
) -> None:
    """Show what a recording holds, how good its clocks and signals are, and how well its motion excites the arm.

    Example: dynid info run.h5 --wanted-rsd 5
    """
    from daq.console import print_json
    from daq.recording import read_recording
    from daq.robot import load_robot
    from ident.info import info_object, print_info, recording_info

    read = read_recording(recording)
    found = recording_info(read, load_robot(robot) if robot else read.robot(), wanted_rsd)
    if as_json:
        print_json(info_object(found, str(recording)))
    else:
        print_info(found, str(recording))


@app.command("identify")
def identify_recordings(
    recordings: list[Path] = typer.Argument(help="Recordings (.h5) of one arm; several stack."),
    out: Path = typer.Option(None, "-o", "--out", help="Folder for result.json and report.html."),
    method: str = typer.Option("wls", "--method", help="Estimator: ols, wls, energy or power."),
    validate_with: list[Path] = typer.Option([], "--validate", help="Held-out recording; the last 30 % without one."),
    split: float = typer.Option(None, "--split", help="Identify on the first SECONDS, validate on the rest."),
    robot: str = typer.Option(None, "--robot", help="Robot file in place of the recording's own."),
    friction: str = typer.Option(None, "--friction", help="none, viscous, coulomb or coulomb-viscous."),
    offset: bool = typer.Option(None, "--offset/--no-offset", help="A constant torque per joint."),
    motor_inertia: bool = typer.Option(None, "--motor-inertia/--no-motor-inertia", help="Columns for motor inertia."),
    smoothing: float = typer.Option(None, "--smoothing", help="ε [rad/s] of tanh(q̇/ε) in place of sign(q̇)."),
    delay: str = typer.Option("auto", "--delay", help="Torque behind position: auto, or SECONDS."),
    position_cutoff: float = typer.Option(None, "--position-cutoff", help="Low-pass of the positions [Hz]."),
    torque_cutoff: float = typer.Option(None, "--torque-cutoff", help="Parallel filter of τ and W [Hz]."),
    decimate: int = typer.Option(None, "--decimate", help="Keep every N-th filtered sample."),
    position_decimate: int = typer.Option(1, "--position-decimate", help="Decimate the positions first (Chebyshev)."),
    filter_kind: str = typer.Option("butterworth", "--filter", help="Parallel filter: butterworth or chebyshev."),
    measured_velocity: bool = typer.Option(False, "--measured-velocity", help="Use the recorded velocity."),
    locked: str = typer.Option(None, "--locked", help="Joints that must not move, separated by commas."),
    torques_of: str = typer.Option(
        None, "--torques-of", help="Joints whose motors' torques are used; all that turn if absent."
    ),
    reversals: float = typer.Option(
        0.0, "--leave-out-reversals", help="Leave out motors slower than this share of their rms velocity, such as 0.2."
    ),
    energy_window: float = typer.Option(
        None, "--energy-window", help="Mean duration of the windows of --method energy [s]."
    ),
    start: float = typer.Option(None, "--start", help="Leave out what lies before [s from the first stamp]."),
    stop: float = typer.Option(None, "--stop", help="Leave out what lies behind [s from the first stamp]."),
    keep_rest: bool = typer.Option(False, "--keep-rest", help="Keep stretches in which no joint moves."),
    significance: float = typer.Option(
        15.0, "--significance", help="Threshold of the relative standard deviation [%]."
    ),
    as_json: bool = JSON,
) -> None:
    """Identify the dynamic model, validate it on held-out data, write result.json and report.html.

    Example: dynid identify run.h5 --validate val.h5 -o model
    """
    from typing import get_args

    from daq.console import progress_line
    from daq.recording import read_recording
    from daq.robot import load_robot
    from drivers.errors import UsageError
    from ident.experiment import ExperimentChoices
    from ident.identify import IdentifyChoices, ModelChoices, identify
    from ident.least_squares import Method
    from ident.option_text import delay_option, joints_option
    from ident.preprocess import PreprocessChoices
    from ident.print_result import print_result
    from ident.report import write_report
    from ident.result import check_folder, result_json, write_result
    from ident.summary import summarise

    *others, last = get_args(Method)
    if method not in (*others, last):
        raise UsageError(f"no method is called '{method}'", hint=f"{', '.join(others)} or {last}")
    if friction not in (None, "none", "viscous", "coulomb", "coulomb-viscous"):
        raise UsageError(f"no friction model is called '{friction}'", hint="none, viscous, coulomb or coulomb-viscous")
    if not 0 < significance <= 100:
        raise UsageError(f"--significance {significance:g} is not a percentage", hint="the papers use 15")
    folder = out if out is not None else Path(f"{recordings[0].stem}-model")
    check_folder(folder)
    given_delay = delay_option(delay)
    choices = IdentifyChoices(
        method=method,  # type: ignore[arg-type]  # checked above
        model=ModelChoices(friction, offset, motor_inertia, smoothing),  # type: ignore[arg-type]
        preprocess=PreprocessChoices(
            position_cutoff=position_cutoff,
            torque_cutoff=torque_cutoff,
            decimate=decimate,
            position_decimate=position_decimate,
            filter_kind=filter_kind,  # type: ignore[arg-type]  # PreprocessChoices checks it
            delay=given_delay or 0.0,
            measured_velocity=measured_velocity,
            start=start,
            stop=stop,
            keep_rest=keep_rest,
        ),
        search_delay=given_delay is None,
        split=split,
        significant_rsd=significance,
        energy_window=energy_window,
        experiment=ExperimentChoices(
            joints_option(locked, "--locked") or (), joints_option(torques_of, "--torques-of") or ()
        ),
        reversals=reversals,
    )
    read = [read_recording(path) for path in recordings]
    held_out = [read_recording(path) for path in validate_with]
    with progress_line(quiet=as_json) as progress:
        found = identify(read, held_out, choices, load_robot(robot) if robot else None, progress)
        progress("report")
        result = summarise(found, read, held_out)
        folder.mkdir(parents=True, exist_ok=True)
        write_result(folder / "result.json", result)
        write_report(folder / "report.html", result, found.fit_series, found.validation_series)
    if as_json:
        print(result_json(result))
        return
    print_result(result)
    print(f"\n{folder / 'result.json'}\n{folder / 'report.html'}")


@app.command("validate")
def validate(
    result: Path = typer.Argument(help="result.json of an identification."),
    recording: Path = typer.Argument(help="Recording (.h5) that it has not seen."),
    as_json: bool = JSON,
) -> None:
    """Predict another recording's torques with a stored model.

    Example: dynid validate model/result.json val.h5
    """
    from dataclasses import asdict

    from daq.console import print_json
    from daq.recording import read_recording
    from ident.print_result import print_fit
    from ident.result import read_result
    from ident.revalidate import revalidate

    stored = read_result(result)
    figures = revalidate(stored, read_recording(recording))
    if as_json:
        lists = {
            name: {key: getattr(value, "tolist", lambda value=value: value)() for key, value in asdict(part).items()}
            for name, part in (("full", figures.full), ("essential", figures.essential))
        }
        print_json({"result": str(result), "recording": str(recording), "joints": stored.joints, **lists})
        return
    for name, part in (("full", figures.full), ("essential", figures.essential)):
        print(f"{name} model: relative error {part.relative_error * 100:.2f} % over {part.samples} filtered samples")
        print_fit(stored.joints, part)
