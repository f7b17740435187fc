"""Checks of a recording's commands, for a servo model: do the positions follow them?"""

from __future__ import annotations

from daq.recording.commanded_motion import CommandedMotion
from daq.recording.quality.command_quality import EARLIEST, SLOWEST, CommandQuality, command_quality
from daq.recording.unit_plausibility import DEGREES, near
from ident.verdict.catalogue import raised
from ident.verdict.check import Check

LEAST_UNCOVERED = 0.25
"""Time with samples but without commands [s] that is reported."""


def command_checks(motion: CommandedMotion, of: str = "") -> list[Check]:
    """What is wrong with commands beside measured positions; `of` begins the sentences."""
    quality = command_quality(motion)
    checks = _cover_checks(motion, quality, of)
    if quality.apart:
        late = quality.delay > 0
        said = "behind" if late else "ahead of"
        why = f"a servo lags by at most {SLOWEST:g} s" if late else f"no servo is more than {-EARLIEST:g} s ahead"
        text = f"{of}positions are {abs(quality.delay):.2f} s {said} their commands, and {why}: two clocks are apart"
        checks.append(raised("command-clock", text))
    if quality.swapped:
        pairs = ", ".join(f"{joint} that of {other}" for joint, other in quality.swapped.items())
        text = f"{of}joints follow the commands of others: {pairs}; is the order of the joints right?"
        checks.append(raised("command-order", text, list(quality.swapped)))
    if quality.opposite:
        text = f"{of}{', '.join(quality.opposite)} move against their commands; are their signs right?"
        checks.append(raised("command-order", text, quality.opposite))
    for factor, unit in (
        (DEGREES, "positions look like degrees, their commands like radians"),
        (1 / DEGREES, "commands look like degrees, the positions like radians"),
    ):
        joints = [joint for joint, ratio in quality.ratios.items() if near(ratio, factor)]
        if joints:
            checks.append(raised("command-unit", f"{of}by their change the {unit}: {', '.join(joints)}", joints))
    if quality.still:
        text = (
            f"{of}the position of {', '.join(quality.still)} never changes while its target goes on: check the "
            "encoder, and whether the motor is on"
        )
        checks.append(raised("encoder-stuck", text, quality.still))
    if quality.resting:
        names = ", ".join(quality.resting)
        text = f"{of}{names}: neither commanded to move nor moving, so that nothing of it can be identified"
        checks.append(raised("joint-at-rest", text, quality.resting))
    return checks


def _cover_checks(motion: CommandedMotion, quality: CommandQuality, of: str) -> list[Check]:
    whole = motion.time[-1] - motion.time[0]
    checks = []
    for missing, place in ((quality.before, "begin {} s after"), (quality.after, "end {} s before")):
        if missing > LEAST_UNCOVERED:
            said = place.format(f"{missing:.3g}")
            checks.append(raised("commands-short", f"{of}the commands {said} the samples, which last {whole:.4g} s"))
    return checks
