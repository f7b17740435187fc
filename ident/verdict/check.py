"""Checks, things that a user should know before trusting a recording or a model: their kinds, and those raised."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

Purpose = Literal["torque_prediction", "simulation", "collision_detection", "payload_estimation"]
"""What a dynamic model is used for; feed-forward control is torque prediction."""

PURPOSES: tuple[Purpose, ...] = get_args(Purpose)
PURPOSE_WORDS: dict[Purpose, str] = {
    "torque_prediction": "torque prediction (feed-forward)",
    "simulation": "simulation",
    "collision_detection": "collision detection",
    "payload_estimation": "payload estimation",
}

Severity = Literal["note", "warning", "serious"]
"""`note`: to know, nothing is spoilt. `warning`: the purposes named are usable at best. `serious`: they are poor."""

SEVERITIES: tuple[Severity, ...] = get_args(Severity)
"""From the mildest to the worst."""


@dataclass(frozen=True)
class Check:
    """One check of the catalogue, raised by a recording or an identification.

    Attributes:
        name: stable, as in docs/checks.md.
        severity: what it does to the purposes named.
        purposes: that it spoils; empty for a note.
        text: what was seen, with its figures, and what to do: one sentence.
        joints: names of the joints that it concerns; empty where it concerns the whole arm.
    """

    name: str
    severity: Severity
    purposes: tuple[Purpose, ...]
    text: str
    joints: tuple[str, ...] = ()


def texts(checks: tuple[Check, ...]) -> list[str]:
    """The sentences of the checks that spoil something."""
    return [check.text for check in checks if check.severity != "note"]


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


def wrong(name: str, meaning: str, remedy: str) -> CheckKind:
    """A kind of mistake that spoils every purpose."""
    return CheckKind(name, "mistake", "serious", ALL, meaning, remedy)


ALL = PURPOSES
PREDICTION: tuple[Purpose, ...] = ("torque_prediction", "collision_detection")
PARAMETERS: tuple[Purpose, ...] = ("simulation", "payload_estimation")
"""Purposes that take the parameters one by one: wrong values that cancel in the torque spoil these only."""
