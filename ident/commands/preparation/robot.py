"""The commands `dynid robot …`."""

from __future__ import annotations

from pathlib import Path

import typer

from daq.commands.help_text import CommandApp, GroupedCommands
from daq.commands.options import FORCE, JSON, ROBOT, out_option
from drivers.core.text import counted

robot_app = CommandApp("Robot", cls=GroupedCommands, invoke_without_command=True)
app = CommandApp("Robot")
app.add_typer(robot_app, name="robot", rich_help_panel="Robot")
app.add_typer(robot_app, name="robots", hidden=True)  # the same by the other word


@robot_app.callback()
def robots(context: typer.Context, as_json: bool = JSON) -> None:
    """List the built-in robots; show one, or write the file of a new one.

    Example: dynid robot
    """
    from daq.commands.console import print_json, print_table
    from daq.robot.loader import builtin_robots, load_robot

    if context.invoked_subcommand is not None:
        return
    listed = [load_robot(name).robot for name in builtin_robots()]
    if as_json:
        print_json({"robots": [{"name": r.name, "dof": r.dof, "description": r.description} for r in listed]})
        return
    print_table("Built-in robots", ("name", "joints", "description"), [(r.name, r.dof, r.description) for r in listed])
    print("\nOne of them: dynid robot show ur5e. A new one: dynid robot new arm.urdf -o my_arm.yaml.")


@robot_app.command("show")
def show(
    robot: str = ROBOT,
    as_yaml: bool = typer.Option(False, "--yaml", help="Print the file itself."),
    as_json: bool = JSON,
) -> None:
    """Show joints, limits and base parameters with their expressions.

    Example: dynid robot show ur5e
    """
    from daq.commands.console import print_json, print_table
    from daq.robot.loader import load_robot
    from drivers.core.units import common_unit
    from ident.checks.robot_description import description, inertial_count
    from ident.model.base_parameters import base_parameters
    from ident.model.dynamic_model import build_model
    from ident.model.symbols import symbolic_expressions

    robot_file = load_robot(robot)
    if as_yaml:
        print(robot_file.text, end="")
        return
    if as_json:
        print_json(description(robot_file))
        return
    model = build_model(robot_file)
    base = base_parameters(model)
    expressions = symbolic_expressions(robot_file, model, base)
    described = robot_file.robot
    print(f"{described.name}: {described.description}".rstrip(": "))
    angle, torque = (common_unit(unit, described.sliding) for unit in ("rad", "N·m"))
    print_table(
        f"Joints; limits in {angle}, s, {torque}",
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
        f"\nBase parameters: {base.count}, {inertial_count(robot_file)} of them inertial",
        ("name", "kind", "expression"),
        zip(base.names, (kind.replace("_", " ") for kind in base.kinds), expressions, strict=True),
    )
    print(f"\nwithout effect: {', '.join(base.no_effect) or 'none'}")
    print(f"rank margin: {base.margin:.1e} between singular values")
    for section, source in described.sources.items():
        print(f"source of {section}: {source}")


@robot_app.command("new")
def new(
    source: str = typer.Argument(None, metavar="[URDF]", help="URDF, or a description's name: panda_description."),
    joints: int = typer.Option(
        None, "--joints", help="Number of joints, for a file without a URDF (modified DH rows)."
    ),
    out: Path = out_option("Robot file to write (.yaml); default: the URDF's name."),
    force: bool = FORCE,
    as_json: bool = JSON,
) -> None:
    """Write a robot file of a URDF that can be simulated at once, TODO where a real arm needs more.

    Names are those of the package robot_descriptions, where it is installed.

    Example: dynid robot new arm.urdf -o my_arm.yaml
    """
    from daq.commands.console import print_json, progress_line
    from daq.robot.new_robot import to_fill_in
    from ident.tasks.new_robot import new_robot_file

    with progress_line(quiet=as_json) as progress:
        written = new_robot_file(source, joints, out, overwrite=force, progress=progress)
    needed = to_fill_in(written.unknown)
    if as_json:
        poses = {name: list(pose) for name, (pose, _) in written.guess.poses.items()}
        print_json({"file": str(written.path), "todo": written.todo, "to_fill_in": needed, "poses": poses})
        return
    arm, guess = written.arm, written.guess
    if arm is None:
        print(f"{written.path}: {written.todo} values are marked TODO")
    else:
        print(f"{written.path}: {counted(len(arm.joints), 'joint')}, tool at link {arm.tool_link}")
        if arm.locked:
            print(f"  locked: {', '.join(name for name, _ in arm.locked)}")
        assumed = [name for name, (_, origin) in guess.links.items() if origin != "the URDF's"]
        mass = sum(link.mass for link, _ in guess.links.values())
        print(f"  masses: the URDF's, {mass:.3g} kg" + (f"; assumed at {', '.join(assumed)}" if assumed else ""))
        if guess.poses:
            print(f"  poses: {', '.join(guess.poses)}")
    print("  still to fill in, each marked TODO, to")
    for purpose, what in needed.items():
        print(f"    {purpose + ':':9} {what}")
    if not written.todo:
        print(f"Simulate it as it stands: dynid sim {written.path}")
    print(f"Then: dynid check {written.path}")
