"""Do the values agree with their stated units?"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from daq.importers.assembly import ImportedSamples, Quantity
from daq.importers.checks import sample_place
from daq.importers.choices import ImportChoices
from daq.importers.table import Note, listed
from daq.recording.commanded_motion import TARGET, CommandedMotion
from daq.recording.quality.command_quality import command_quality
from daq.recording.unit_plausibility import DEGREES, beyond_reach, displacement_ratios, near, other_unit
from daq.robot.schema import Robot
from drivers.core.errors import ImportFileError

FULL_RANGE = 101.0
"""Largest size of positions that may be percent of a range."""

_MILLIAMPERE = 500.0
_TORQUE_EXCESS = 10.0


def check_units(
    samples: ImportedSamples, robot: Robot, sliding: frozenset[str], choices: ImportChoices, where: str
) -> ImportedSamples:
    """Compare positions with the joint limits and velocities with the change of position.

    Returns:
        The samples with doubts as notes.

    Raises:
        ImportFileError: positions that can only be degrees; position and velocity in different units.
    """
    notes: list[Note] = []
    position = samples.quantities["position"]
    notes.extend(_check_positions(samples, position, robot, sliding, choices, where))
    if "velocity" in samples.quantities:
        notes.extend(_check_velocity(samples, position, samples.quantities["velocity"], sliding, where))
    _check_commands(samples, where)
    current = samples.quantities.get("current")
    if current is not None and np.abs(current.values).max() > _MILLIAMPERE:
        notes.append(Note("warning", f"current reaches {np.abs(current.values).max():.4g} A; is it in mA?"))
    torque = samples.quantities.get("torque")
    if torque is not None:
        for column, limits in enumerate(robot.joints):
            peak = float(np.abs(torque.values[:, column]).max())
            if limits.torque is not None and peak > _TORQUE_EXCESS * limits.torque:
                limit = f"{limits.torque:g} {limits.unit('N·m')}"
                text = f"torque of {limits.name} reaches {peak:.4g}, its limit is {limit}; check its unit"
                notes.append(Note("warning", text))
    return replace(samples, notes=(*samples.notes, *notes))


def _check_positions(
    samples: ImportedSamples,
    position: Quantity,
    robot: Robot,
    sliding: frozenset[str],
    choices: ImportChoices,
    where: str,
) -> list[Note]:
    notes = []
    far: list[str] = []
    fitting: list[str] = []
    small: list[str] = []
    for column, limits in enumerate(robot.joints):
        values = position.values[:, column]
        low, high = limits.position
        excess = np.maximum(values - high, low - values)
        worst = int(excess.argmax())
        if limits.name in sliding:
            if unit := other_unit(samples.time, values, limits):
                raise ImportFileError(
                    f"position {values[worst]:.4g} m is far outside the joint's limits; it looks like {unit}",
                    where=f"{sample_place(samples, worst, where)}, joint {limits.name}",
                    hint="state the unit in the header: q1 [mm]" if unit == "mm" else "convert them to m first",
                )
        else:
            reach = max(abs(low), abs(high)) + 2 * math.pi
            (far if beyond_reach(values, limits.position) else fitting).append(limits.name)
            if choices.degrees and np.abs(values).max() * DEGREES <= min(reach, 2 * math.pi) and np.ptp(values) > 0.002:
                small.append(limits.name)
        if excess[worst] > 0 and limits.name not in far:
            text = f"position of {limits.name} is {excess[worst]:.4g} outside its limits {list(limits.position)}"
            notes.append(Note("warning", text, worst))
    if far:
        column = robot.joint_names.index(far[0])
        peak = int(np.abs(position.values[:, column]).argmax())
        value = position.values[peak, column]
        place = f"{sample_place(samples, peak, where)}, joint {far[0]}"
        if choices.degrees:
            raise ImportFileError(f"position is {value:.4g} rad after the conversion from degrees", where=place)
        mixed = f"; {listed(fitting)} would fit as radians, so the file may mix units" if fitting else ""
        columns = [robot.joint_names.index(name) for name in far]
        degrees = not any(
            beyond_reach(position.values[:, joint] / DEGREES, robot.joints[joint].position) for joint in columns
        )
        looks = f"{'looks' if len(far) == 1 else 'look'} like {'degrees' if degrees else 'counts of an encoder'}"
        hint = "convert them to radians first: counts less those at zero, times 2π over the counts of a turn"
        if degrees:
            hint = "--degrees if all joints are in degrees; a header such as q1 [deg] states one joint's unit"
            if all(np.abs(position.values[:, joint]).max() <= FULL_RANGE for joint in columns):
                hint += "; convert percent of a range (LeRobot's -100 to 100, a gripper's 0 to 100) to radians first"
        raise ImportFileError(
            f"position {value:.4g} is far outside the joint's limits; {listed(far)} {looks}{mixed}",
            where=place,
            hint=hint,
        )
    if small:
        text = f"before the conversion from degrees the positions of {listed(small)} stayed below 2π"
        notes.append(Note("warning", f"{text}; were they in radians already?"))
    return notes


def _check_commands(samples: ImportedSamples, where: str) -> None:
    """Compare the changes of positions and commands."""
    commanded = samples if samples.commands is None else samples.commands
    if TARGET not in commanded.quantities:
        return
    position, target = samples.quantities["position"], commanded.quantities[TARGET]
    motion = CommandedMotion(position.joints, samples.time, position.values, commanded.time, {TARGET: target.values})
    for joint, ratio in command_quality(motion).ratios.items():
        for expected, degrees, radians in ((DEGREES, "q", TARGET), (1 / DEGREES, TARGET, "q")):
            if near(ratio, expected):
                raise ImportFileError(
                    f"mixed units: judging by its change, the {'position' if degrees == 'q' else 'command'} "
                    f"looks like degrees, the {'command' if degrees == 'q' else 'position'} like radians",
                    where=f"{where}: joint {joint}",
                    hint=f"state them in the header: {degrees}1 [deg], {radians}1 [rad]",
                )


def _check_velocity(
    samples: ImportedSamples, position: Quantity, velocity: Quantity, sliding: frozenset[str], where: str
) -> list[Note]:
    ratios = displacement_ratios(samples.time, position.values, velocity.values)
    ratio_of = {joint: ratio for joint, ratio in zip(position.joints, ratios, strict=True) if ratio is not None}
    for joint, ratio in ratio_of.items():
        place = f"{where}: joint {joint}"
        angular = joint not in sliding
        if angular and near(ratio, DEGREES):
            raise ImportFileError(
                "mixed units: the position looks like degrees, the velocity like radians per second",
                where=place,
                hint="state them in the header: q1 [deg], qd1 [rad/s]",
            )
        if angular and near(ratio, 1 / DEGREES):
            raise ImportFileError(
                "mixed units: the position looks like radians, the velocity like degrees per second",
                where=place,
                hint="state them in the header: q1 [rad], qd1 [deg/s]",
            )
        for unit, factor in (("ms", 1e-3), ("us", 1e-6)):
            if near(ratio, factor):
                raise ImportFileError(
                    f"the velocity is {1 / factor:g} times too large for the positions: the stamps look like {unit}",
                    where=place,
                    hint=f"--time-unit {unit}",
                )
    doubtful = [f"{joint} ({ratio:.3g})" for joint, ratio in ratio_of.items() if not 0.5 < ratio < 2.0]
    if not doubtful:
        return []
    text = f"velocity is not the change of position; ratio of change to ∫velocity dt: {listed(doubtful)}"
    return [Note("warning", text)]
