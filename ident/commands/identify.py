"""The command `dynid identify`."""

from __future__ import annotations

from pathlib import Path

import typer

from ident.commands.options import (
    ACCEPT,
    DELAY,
    ESSENTIAL,
    FORCE,
    JSON,
    MAX_ERROR,
    MAX_JOINT_ERROR,
    MAX_RMSE,
    METHOD,
    SIGNIFICANCE,
)

app = typer.Typer()


@app.command("identify")
def identify_recordings(
    recordings: list[Path] = typer.Argument(help="Recordings (.h5) of one arm; several are stacked."),
    out: Path = typer.Option(None, "-o", "--out", help="Folder for result.json and report.html."),
    method: str = METHOD,
    validate_with: list[Path] = typer.Option([], "--validate", help="Held-out recording; the last 30 % without one."),
    split: float = typer.Option(None, "--split", help="Identify on the first SECONDS, validate on the rest."),
    robot: str = typer.Option(None, "--robot", help="Robot file in place of the recording's own."),
    friction: str = typer.Option(
        None, "--friction", help="auto (default), coulomb-viscous, coulomb-viscous+stribeck+load, …; see docs."
    ),
    friction_from: Path = typer.Option(
        None, "--friction-from", help="Folder or friction.json of dynid friction: terms, shapes, temperature terms."
    ),
    offset: bool = typer.Option(None, "--offset/--no-offset", help="A constant torque per joint."),
    motor_inertia: bool = typer.Option(None, "--motor-inertia/--no-motor-inertia", help="Columns for motor inertia."),
    smoothing: float = typer.Option(None, "--smoothing", help="ε [rad/s] of tanh(q̇/ε) in place of sign(q̇)."),
    delay: str = DELAY,
    position_cutoff: float = typer.Option(None, "--position-cutoff", help="Low-pass of the positions [Hz]."),
    torque_cutoff: float = typer.Option(None, "--torque-cutoff", help="Parallel filter of τ and W [Hz]."),
    decimate: int = typer.Option(None, "--decimate", help="Keep every N-th filtered sample."),
    position_decimate: int = typer.Option(1, "--position-decimate", help="Decimate the positions first (Chebyshev)."),
    filter_kind: str = typer.Option("butterworth", "--filter", help="Parallel filter: butterworth or chebyshev."),
    differentiation: str = typer.Option(
        "butterworth", "--differentiation", help="q̇ and q̈ by butterworth, kalman, five-point or savitzky-golay."
    ),
    kalman_noise: str = typer.Option(
        None, "--kalman-noise", help="Q,R of kalman: density of the 4th derivative [rad²/s⁷], variance [rad²]."
    ),
    measured_velocity: bool = typer.Option(False, "--measured-velocity", help="Use the recorded velocity."),
    locked: str = typer.Option(None, "--locked", help="Joints that must not move, separated by commas."),
    torques_of: str = typer.Option(
        None, "--torques-of", help="Joints whose motor torques are used; all moving motors if absent."
    ),
    rest_tolerance: float = typer.Option(
        None,
        "--rest-tolerance",
        help="A joint that stays within this range [rad or m] counts as locked; default 0.005.",
    ),
    reversals: float = typer.Option(
        None,
        "--leave-out-reversals",
        help="Leave out velocity reversals: motors slower than this share of their RMS velocity; default 0.05.",
    ),
    presliding: bool = typer.Option(
        True, "--presliding/--no-presliding", help="Dry friction that changes over a travel at velocity reversals."
    ),
    start: float = typer.Option(None, "--start", help="Leave out samples before this time [s from the first stamp]."),
    stop: float = typer.Option(None, "--stop", help="Leave out samples after this time [s from the first stamp]."),
    keep_rest: bool = typer.Option(
        False, "--keep-rest", help="Keep samples at rest: segments in which no joint moves, motors at rest."
    ),
    essential: str = ESSENTIAL,
    significance: float = SIGNIFICANCE,
    accept: Path = ACCEPT,
    max_error: float = MAX_ERROR,
    max_joint_error: float = MAX_JOINT_ERROR,
    max_rmse: float = MAX_RMSE,
    force: bool = FORCE,
    as_json: bool = JSON,
) -> None:
    """Identify the dynamic model, validate it on held-out data, write result.json and report.html.

    Example: dynid identify run.h5 --validate val.h5 -o model
    """
    from daq.commands.console import progress_line
    from daq.output_files import REPORT_FILE, RESULT_FILE, check_output_folder
    from daq.robot.loader import load_robot
    from ident.commands.options import delay_option, limits_option, names_option, numbers_option
    from ident.commands.print_result import print_result
    from ident.result.friction_experiment import friction_path
    from ident.tasks.identification import identify

    folder = out if out is not None else Path(f"{recordings[0].stem}-model")
    experiment = None if friction_from is None else friction_path(friction_from)
    inputs = [*recordings, *validate_with, accept, experiment, *(load_robot(robot).files if robot else ())]
    check_output_folder(folder, (RESULT_FILE, REPORT_FILE), inputs, overwrite=force)
    limits = limits_option(accept, max_error, max_joint_error, max_rmse)
    with progress_line(quiet=as_json) as progress:
        result = identify(
            recordings,
            validation=validate_with,
            robot=robot,
            method=method,
            split=split,
            friction=friction,
            friction_from=friction_from,
            offset=offset,
            motor_inertia=motor_inertia,
            smoothing=smoothing,
            delay=delay_option(delay),
            position_cutoff=position_cutoff,
            torque_cutoff=torque_cutoff,
            decimate=decimate,
            position_decimate=position_decimate,
            filter=filter_kind,  # type: ignore[arg-type]
            differentiation=differentiation,  # type: ignore[arg-type]
            kalman_noise=numbers_option(kalman_noise, "--kalman-noise"),  # type: ignore[arg-type]
            measured_velocity=measured_velocity,
            locked=names_option(locked, "--locked") or (),
            torques_of=names_option(torques_of, "--torques-of") or (),
            rest_tolerance=rest_tolerance,
            leave_out_reversals=reversals,
            presliding=presliding,
            start=start,
            stop=stop,
            keep_rest=keep_rest,
            essential=essential,  # type: ignore[arg-type]
            significance=significance,
            accept=limits,
            progress=progress,
        )
        progress("report")
        result.save(folder)
    if as_json:
        print(result.to_json())
    else:
        print_result(result.result)
        print(f"\n{folder / RESULT_FILE}\n{folder / REPORT_FILE}")
    if result.acceptance is not None and not result.acceptance.passed:
        raise typer.Exit(1)
