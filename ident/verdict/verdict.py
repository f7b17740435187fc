"""How far a model, or a recording, can be trusted: a pure function of the checks and the held-out errors."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from html import escape
from typing import Literal, get_args

from drivers.percentage import percent_text
from ident.verdict.catalogue import CATALOGUE
from ident.verdict.check import PURPOSE_WORDS, PURPOSES, SEVERITIES, Check, Purpose, Severity

Grade = Literal["good", "usable", "poor"]
GRADES: tuple[Grade, ...] = get_args(Grade)
"""From the best to the worst."""

GOOD_ERROR = 0.05
USABLE_ERROR = 0.10
"""Relative held-out errors of the whole arm below which a model is good and usable; published arms lie between 1.4 and
8.5 % (docs/identification.md)."""

GOOD_JOINT_ERROR = 0.15
USABLE_JOINT_ERROR = 0.30
"""The same of a single joint: its torque is smaller than the whole arm's, and its friction and noise a larger part."""

AT_BEST: dict[Severity, Grade] = {"note": "good", "warning": "usable", "serious": "poor"}
"""What a purpose can be at best that a check of this severity spoils."""


@dataclass(frozen=True)
class Errors:
    """Held-out errors, as ratios of the torque: ‖measured − predicted‖ / ‖measured‖.

    Attributes:
        whole: of all joints together; None where it is not known.
        joints: by the joint's name; None where its torque is not predicted.
    """

    whole: float | None
    joints: dict[str, float | None]


@dataclass(frozen=True)
class PurposeVerdict:
    """Whether a model serves a purpose, and why no better."""

    grade: Grade
    because: str


@dataclass(frozen=True)
class JointVerdict:
    """Whether a joint's torque is predicted well, and why no better.

    Attributes:
        joint: its name.
        grade: of the worst purpose that a check about this joint spoils, and of its error.
        because: the reason.
        error: held-out relative error; None where there is none.
    """

    joint: str
    grade: Grade
    because: str
    error: float | None = None


@dataclass(frozen=True)
class Verdict:
    """What follows from the checks and the held-out errors.

    Attributes:
        headline: what it is good, usable and poor for, and why; the worst joint if it is not good.
        purposes: by the purpose's name.
        joints: worst first.
        checks: all that were raised, the most serious first.
        basis: what was fitted and held out, in a sentence or two.
    """

    headline: str
    purposes: dict[Purpose, PurposeVerdict] = field(default_factory=dict)
    joints: tuple[JointVerdict, ...] = ()
    checks: tuple[Check, ...] = ()
    basis: str = ""

    @property
    def lines(self) -> list[str]:
        """For the terminal: the headline, what it rests on, purposes, the worst joints, checks."""
        reasons = [
            f"  {PURPOSE_WORDS[purpose]}: {judged.grade}, {judged.because}" for purpose, judged in self.purposes.items()
        ]
        worst = [f"  {one.joint}: {one.grade}, {one.because}" for one in self.joints if one.grade != "good"]
        return [
            self.headline,
            *([self.basis] if self.basis else []),
            *reasons,
            *worst,
            *(f"{check.severity}: {check.text} [{check.name}]" for check in self.checks),
        ]

    def __str__(self) -> str:
        return "\n".join(self.lines)

    def _repr_html_(self) -> str:
        headline, *others = self.lines
        items = "".join(f"<li>{escape(line.strip())}</li>" for line in others)
        return f"<p><strong>{escape(headline)}</strong></p><ul>{items}</ul>"


@dataclass(frozen=True)
class _Reason:
    grade: Grade
    text: str


def judge(checks: Iterable[Check], errors: Errors | None, basis: str = "") -> Verdict:
    """The verdict on a model, or on a recording that nothing was identified from yet.

    A purpose is as good as the held-out error allows, and at best `usable` (`poor`) where a warning (a serious check)
    spoils it. So one more check never improves a purpose, and a purpose that is spoilt is never good.

    Args:
        checks: that were raised.
        errors: held-out; None for a recording.
        basis: what they rest on, in words.
    """
    ordered = tuple(sorted(dict.fromkeys(checks), key=lambda check: -SEVERITIES.index(check.severity)))
    joints = () if errors is None else _joints(ordered, errors)
    purposes = {purpose: _purpose(purpose, ordered, errors, joints) for purpose in PURPOSES}
    return Verdict(_headline(purposes, joints), purposes, joints, ordered, basis)


def together(verdicts: Sequence[tuple[str, Verdict]]) -> Verdict:
    """One verdict from several, each with its label: the worst of every purpose and of every joint.

    Raises:
        ValueError: there is none.
    """
    if not verdicts:
        raise ValueError("no verdict to sum up")
    if len(verdicts) == 1:
        return verdicts[0][1]
    purposes = {}
    for purpose in PURPOSES:
        label, worst = max(verdicts, key=lambda one: GRADES.index(one[1].purposes[purpose].grade))
        judged = worst.purposes[purpose]
        purposes[purpose] = PurposeVerdict(judged.grade, f"{label}: {judged.because}")
    joints: dict[str, JointVerdict] = {}
    for label, verdict in verdicts:
        for one in verdict.joints:
            if one.joint not in joints or _badness(one) > _badness(joints[one.joint]):
                joints[one.joint] = JointVerdict(one.joint, one.grade, f"{label}: {one.because}", one.error)
    checks = dict.fromkeys(check for _, verdict in verdicts for check in verdict.checks)
    ordered = tuple(sorted(checks, key=lambda check: -SEVERITIES.index(check.severity)))
    basis = " ".join(f"{label}: {verdict.basis}" for label, verdict in verdicts if verdict.basis)
    worst_first = tuple(sorted(joints.values(), key=lambda one: _negative(_badness(one))))
    return Verdict(_headline(purposes, worst_first), purposes, worst_first, ordered, basis)


def _joints(checks: Sequence[Check], errors: Errors) -> tuple[JointVerdict, ...]:
    """Every joint, worst first."""
    judged = []
    for joint, error in errors.joints.items():
        known = _known(error)
        reasons = [_check_reason(check) for check in checks if joint in check.joints]
        if known is not None:
            grade = _grade(known, GOOD_JOINT_ERROR, USABLE_JOINT_ERROR)
            reasons.append(_Reason(grade, f"its held-out error is {percent_text(known, 2)}"))
        worst = _worst(reasons) if reasons else _Reason("good", "its torque is not predicted")
        judged.append(JointVerdict(joint, worst.grade, worst.text, known))
    return tuple(sorted(judged, key=lambda one: _negative(_badness(one))))


def _purpose(
    purpose: Purpose, checks: Sequence[Check], errors: Errors | None, joints: Sequence[JointVerdict]
) -> PurposeVerdict:
    reasons = [_check_reason(check) for check in checks if purpose in check.purposes]
    if errors is not None:
        whole = _known(errors.whole)
        if whole is None:
            reasons.append(_Reason("usable", "no held-out error is known"))
        else:
            grade = _grade(whole, GOOD_ERROR, USABLE_ERROR)
            reasons.append(_Reason(grade, f"the held-out error is {percent_text(whole, 2)}"))
        if purpose == "collision_detection":  # a collision is seen in each joint's torque by itself
            known = [one for one in joints if one.error is not None]
            largest = max(known, key=lambda one: one.error or 0.0, default=None)
            if largest is not None and largest.error is not None:
                grade = _grade(largest.error, GOOD_JOINT_ERROR, USABLE_JOINT_ERROR)
                reasons.append(
                    _Reason(grade, f"the held-out error of {largest.joint} is {percent_text(largest.error, 2)}")
                )
    if not reasons:
        return PurposeVerdict("good", "no check speaks against it")
    worst = _worst(reasons)
    return PurposeVerdict(worst.grade, worst.text)


def _check_reason(check: Check) -> _Reason:
    kind = CATALOGUE.get(check.name)
    who = f" ({', '.join(check.joints)})" if check.joints else ""
    return _Reason(AT_BEST[check.severity], f"{kind.meaning}{who}" if kind is not None else check.text)


def _worst(reasons: Sequence[_Reason]) -> _Reason:
    """The first of the worst."""
    return max(reasons, key=lambda reason: GRADES.index(reason.grade))


def _grade(error: float, good: float, usable: float) -> Grade:
    return "good" if error < good else "usable" if error < usable else "poor"


def _badness(one: JointVerdict) -> tuple[int, float]:
    return GRADES.index(one.grade), one.error if one.error is not None else -1.0


def _negative(badness: tuple[int, float]) -> tuple[int, float]:
    return -badness[0], -badness[1]


def _known(error: float | None) -> float | None:
    return None if error is None or not math.isfinite(error) else error


def _headline(purposes: dict[Purpose, PurposeVerdict], joints: Sequence[JointVerdict]) -> str:
    """What the model is good, usable and poor for, the reason of the worst, and the worst joint if it is not good."""
    parts = []
    for grade in GRADES:
        of_grade = [PURPOSE_WORDS[purpose] for purpose in PURPOSES if purposes[purpose].grade == grade]
        if of_grade:
            parts.append(f"{grade} for {_listed(of_grade)}")
    worst = max(purposes.values(), key=lambda judged: GRADES.index(judged.grade))
    text = "; ".join(parts)
    text = text[0].upper() + text[1:]
    joint = f" Worst joint: {joints[0].joint}, {joints[0].because}." if joints and joints[0].grade != "good" else ""
    return f"{text}: {worst.because}.{joint}"


def _listed(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"
