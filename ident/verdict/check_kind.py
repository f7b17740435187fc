"""What a kind of check is: its severity, the purposes that it spoils, its meaning and its remedy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from ident.verdict.check import PURPOSES, Purpose, Severity

Subject = Literal["mistake", "data", "model"]
"""`mistake`: recording or robot file say something wrong, which other checks may follow from. `data`: what was recorded
does not show all that is asked. `model`: what was found."""


@dataclass(frozen=True)
class CheckKind:
    """What all checks of one name have in common."""

    name: str  # stable; part of result.json
    subject: Subject  # what it speaks of
    severity: Severity  # of every check of this name
    purposes: tuple[Purpose, ...]  # that it spoils; none exactly where it is a note
    meaning: str  # what it says, as a clause
    remedy: str  # what to do, as a sentence
    # whether a verdict's reason is not the meaning, but the sentence of the check up to its semicolon
    figures: bool = False


def note(name: str, subject: Subject, meaning: str, remedy: str) -> CheckKind:
    """A kind that spoils no purpose."""
    return CheckKind(name, subject, "note", (), meaning, remedy)


ALL = PURPOSES
PREDICTION: tuple[Purpose, ...] = ("torque_prediction", "collision_detection")
PARAMETERS: tuple[Purpose, ...] = ("simulation", "payload_estimation")
"""Purposes that take the parameters one by one: wrong values that cancel in the torque spoil these only."""
