"""Checks of a recording's commands: do the positions follow them, so that a servo model can be identified?"""

from __future__ import annotations

from daq.recording.commanded_motion import CommandedMotion
from daq.recording.quality.command_quality import LEAST_LAG, MOST_LAG, CommandQuality, command_quality
from daq.recording.unit_plausibility import DEGREES, near
from drivers.core.errors import DataError
from drivers.core.text import counted
from ident.verdict.catalogue import CATALOGUE, raised
from ident.verdict.check import Check

LEAST_UNCOVERED = 0.25
"""Time with samples but without commands [s] that is reported."""

MOST_UNCOVERED = 1.0
"""The same [s] beyond which a servo model is not identified."""

OTHER_UNIT = 20.0
"""Ratio of the changes of positions and commands, or its inverse, from which on the two are in different units."""


def command_checks(motion: CommandedMotion, quality: CommandQuality) -> list[Check]:
    """Return what is wrong with commands beside measured positions."""
    checks = _cover_checks(motion, quality)
    if quality.copied is not None or quality.unrelated:
        rows = quality.copied
        when = f" of {counted(abs(rows), 'row')} {'later' if rows > 0 else 'earlier'}" if rows else ""
        text = (
            "no joint moves as its command does: are the commands changes of position, or velocities?"
            if rows is None
            else f"the commands are the measured positions{when}, so nothing shows what the servos do with a command"
        )
        checks.append(raised("command-other", text))
    # First: a joint that follows its command only at times looks like one with a wrong clock or order.
    for joint, (first, last) in quality.frozen.items():
        text = (
            f"the position of {joint} does not change from {first:.4g} s to {last:.4g} s while its target moves to "
            "both sides of it: check the encoder and its cable"
        )
        checks.append(raised("encoder-stuck", text, [joint]))
    if quality.apart:
        late = quality.delay > 0
        said = "behind" if late else "ahead of"
        why = f"a servo lags by at most {MOST_LAG:g} s" if late else f"no servo is more than {-LEAST_LAG:g} s ahead"
        text = f"positions are {abs(quality.delay):.2f} s {said} their commands, and {why}: the clocks differ"
        checks.append(raised("command-clock", text))
    if quality.swapped:
        pairs = ", ".join(f"{joint} that of {other}" for joint, other in quality.swapped.items())
        text = f"joints follow the commands of others: {pairs}; is the order of the joints right?"
        checks.append(raised("command-order", text, list(quality.swapped)))
    if quality.opposite:
        one = len(quality.opposite) == 1
        moves = "moves against its command; is its sign" if one else "move against their commands; are their signs"
        text = f"{', '.join(quality.opposite)} {moves} right?"
        checks.append(raised("command-order", text, quality.opposite))
    checks += _unit_checks(quality)
    if quality.still:
        text = (
            f"the position of {', '.join(quality.still)} never changes while its target moves: check the encoder, "
            "and whether the motor is on"
        )
        checks.append(raised("encoder-stuck", text, quality.still))
    if quality.resting:
        names = ", ".join(quality.resting)
        text = f"{names}: at rest, and hardly commanded to move, so nothing about them can be identified"
        checks.append(raised("joint-at-rest", text, quality.resting))
    return checks


def refuse_unusable_commands(motion: CommandedMotion, where: str) -> None:
    """Refuse commands that no servo model can be identified from.

    Raises:
        DataError: positions do not follow their commands, or the commands end long before them.
    """
    quality = command_quality(motion)
    for check in command_checks(motion, quality):
        short = check.name == "commands-short" and max(quality.before, quality.after) > MOST_UNCOVERED
        if check.severity == "serious" or short:
            raise DataError(check.text, where=where, hint=CATALOGUE[check.name].remedy)
        if check.name == "encoder-stuck":
            raise DataError(check.text, where=where, hint="record again, or omit this recording")


def _cover_checks(motion: CommandedMotion, quality: CommandQuality) -> list[Check]:
    whole = motion.time[-1] - motion.time[0]
    checks = []
    for missing, place in ((quality.before, "begin {} s after"), (quality.after, "end {} s before")):
        if missing > LEAST_UNCOVERED:
            said = place.format(f"{missing:.3g}")
            checks.append(raised("commands-short", f"the commands {said} the samples, which last {whole:.4g} s"))
    return checks


def _unit_checks(quality: CommandQuality) -> list[Check]:
    checks = []
    if quality.offsets:
        listed = ", ".join(f"{joint} by {offset:.2f}" for joint, offset in quality.offsets.items())
        text = f"positions follow their commands at another zero: {listed} [rad or m]; are both of one calibration?"
        checks.append(raised("command-unit", text, list(quality.offsets)))
    for large, unit in (
        (True, "positions look like degrees, their commands like radians"),
        (False, "commands look like degrees, the positions like radians"),
    ):
        ratios = {joint: ratio if large else 1 / ratio for joint, ratio in quality.ratios.items()}
        apart = {joint: ratio for joint, ratio in ratios.items() if ratio > OTHER_UNIT}
        degrees = [joint for joint, ratio in apart.items() if near(ratio, DEGREES)]
        if degrees:
            checks.append(raised("command-unit", f"judging by their change, the {unit}: {', '.join(degrees)}", degrees))
        others = [joint for joint in apart if joint not in degrees]
        if others:
            listed = ", ".join(f"{joint} {quality.ratios[joint]:.3g}" for joint in others)
            text = f"positions and their commands are in different units, by the ratio of their changes: {listed}"
            checks.append(raised("command-unit", text, others))
    return checks
