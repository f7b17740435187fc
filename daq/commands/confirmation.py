"""The summary that is printed before an arm moves, and the question whether it may."""

from __future__ import annotations

import select
import sys
from collections.abc import Sequence
from contextlib import suppress
from typing import TextIO

import numpy as np

from daq.motion.approach import checked_approach
from daq.motion.motion_check import UNCHECKED, MotionCheck, MotionFigures
from daq.motion.player import STALL_LIMIT
from daq.motion.trajectories import Motion
from daq.robot.schema import JointLimits
from daq.session.supervisor import TRACKING_ERROR
from drivers.core.arrays import FloatArray
from drivers.core.text import percent_text
from drivers.core.units import common_unit

_SHOWN = 3
"""Clearances that are shown at most, the smallest ones."""


def motion_lines(figures: MotionFigures) -> list[str]:
    """Return what will move where, a line per figure."""
    lines = [
        f"tool point: lowest {figures.lowest:.3f} m (above the base frame's origin), farthest {figures.farthest:.3f} m "
        f"from it, at most {figures.tool_speed:.2f} m/s",
        f"fastest joint: {figures.fastest_joint}, {percent_text(figures.speed_share, 2)} of its velocity limit",
    ]
    for clearance in figures.clearances[:_SHOWN]:
        lines.append(
            f"smallest clearance to {clearance.what}: {clearance.distance:.3f} m "
            f"(link {clearance.link}, at {clearance.time:.1f} s)"
        )
    if not figures.clearances:
        lines.append("clearance: the robot file names nothing to keep clear of")
    if figures.torque_share is None:
        lines.append("torque: not predicted, since the arm's parameters or torque limits are unknown")
    else:
        share = f"{percent_text(figures.torque_share, 2)} of its limit"
        lines.append(f"torque: predicted to be at most {share} ({figures.torque_joint})")
    return lines


def unchecked_lines(figures: MotionFigures) -> list[str]:
    """The pairs of links that no check keeps apart, the same in every motion of an arm; nothing where there is none."""
    return [f"{UNCHECKED}: {'; '.join(figures.unchecked)}"] if figures.unchecked else []


class Confirmation:
    """Tells a person where the arm will go, and asks; a `daq.session.play.Permission`.

    Without a `question` the answer is yes already; without a `screen` the approach is described nowhere.
    """

    def __init__(
        self,
        motion: Motion,
        limits: Sequence[JointLimits],
        check: MotionCheck,
        question: tuple[TextIO, TextIO] | None,
        screen: TextIO | None,
    ) -> None:
        self._start = motion.evaluate(np.zeros(1))[0][:, 0]
        self._limits = limits
        self._check = check
        self._question = question
        self._screen = screen
        self.figures: MotionFigures | None = None
        """Figures of the approach to the start pose, once it is known."""
        self.to_mind: Sequence[str] = ()
        """What the controller or its drives are known for, one line each."""

    def approach(self, position: FloatArray) -> Motion:
        """The first way that passes the check."""
        way, self.figures = checked_approach(position, self._start, self._limits, self._check)
        return way

    def ask(self) -> None:
        """Describe the way, then ask."""
        if self._screen is not None and self.figures is not None:
            tell(
                f"first the approach to the start pose, {self.figures.duration:.1f} s",
                motion_lines(self.figures),
                self._screen,
            )
        if self._screen is not None:
            tell("while it moves, the arm is stopped as soon as", _held(self._limits), self._screen)
            if self.to_mind:
                tell("note about this arm's controller or drives:", self.to_mind, self._screen)
        if self._question is not None:
            ask_on(self._question, "Move the arm? [y/N] ")

    def answer(self) -> bool | None:
        """Answer as `answer_of`; yes where no question is asked."""
        return True if self._question is None else answer_of(self._question)


def ask_on(terminal: tuple[TextIO, TextIO], question: str) -> None:
    """Print a question on a terminal (input, output), after what was typed before it is forgotten."""
    source, out = terminal
    _forget_typed(source)
    print(question, end="", file=out, flush=True)


def answer_of(terminal: tuple[TextIO, TextIO]) -> bool | None:
    """Yes for `y` or `yes`; no for anything else, the end of the input among it; None before."""
    source, _ = terminal
    if not select.select([source], [], [], 0.0)[0]:
        return None
    return source.readline().strip().lower() in {"y", "yes"}


def _held(limits: Sequence[JointLimits]) -> list[str]:
    """Return what the command gate holds."""
    sliding = [joint.sliding for joint in limits]
    velocity, acceleration = (
        f"{', '.join(f'{getattr(joint, name):.3g}' for joint in limits)} {common_unit(unit, sliding)}"
        for name, unit in (("velocity", "rad/s"), ("acceleration", "rad/s²"))
    )
    return [
        f"a command is faster than {velocity} or changes faster than {acceleration} (joint by joint)",
        f"a command is {TRACKING_ERROR:g} {common_unit('rad', sliding)} away from what the arm does, or outside the "
        "position limits",
        f"this computer stalls for longer than the arm bridges without commands ({1e3 * STALL_LIMIT:.0f} ms at most), "
        "or samples or the connection fail",
    ]


def _forget_typed(terminal: TextIO) -> None:
    """Throw away what was typed before the question: it answers something else."""
    try:
        import termios
    except ImportError:  # Windows
        return
    with suppress(OSError, ValueError, termios.error):
        termios.tcflush(terminal.fileno(), termios.TCIFLUSH)


def tell(title: str, lines: Sequence[str], out: TextIO) -> None:
    """Print a title and lines below it."""
    print(title, *(f"  {line}" for line in lines), sep="\n", file=out, flush=True)


def terminal() -> tuple[TextIO, TextIO] | None:
    """Return where a person can be asked: standard input and error; None where either is no terminal."""
    return (sys.stdin, sys.stderr) if sys.stdin.isatty() and sys.stderr.isatty() else None
