"""How far a model, or a recording, can be trusted: a pure function of the checks and the held-out errors."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from html import escape
from typing import Literal, get_args

from drivers.core.text import percent_text, rounded
from ident.verdict.catalogue import CATALOGUE
from ident.verdict.check import PURPOSE_WORDS, PURPOSES, SEVERITIES, Check, Purpose, Severity
from ident.verdict.evidence import Evidence, MotionError, known

Grade = Literal["good", "usable", "poor"]
GRADES: tuple[Grade, ...] = get_args(Grade)
"""From the best to the worst."""

GOOD_ERROR = 0.05
USABLE_ERROR = 0.10
"""Relative held-out errors of the whole arm below which a model is good and usable; published arms lie between 1.4 and
8.5 % (docs/checks.md)."""

GOOD_JOINT_ERROR = 0.15
USABLE_JOINT_ERROR = 0.30
"""The same of a single joint: its torque is smaller than the whole arm's, and its friction and noise a larger part."""

GOOD_MOTION = 0.5
USABLE_MOTION = 1.0
"""Errors of a simulated motion over those of constant velocity: a model that is no better than that is poor."""

GOOD_JOINT_MOTION = 1.0
USABLE_JOINT_MOTION = 2.0
"""The same of a single joint, which may hardly move in the few windows that are simulated."""

AT_BEST: dict[Severity, Grade] = {"note": "good", "warning": "usable", "serious": "poor"}
"""What a purpose can be at best that a check of this severity spoils."""


@dataclass(frozen=True)
class PurposeVerdict:
    """Tells whether a model serves a purpose, and why no better."""

    grade: Grade
    because: str


@dataclass(frozen=True)
class JointVerdict:
    """Tells whether a joint's torque is predicted well, and why no better.

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
    def grades(self) -> str:
        """Return what it is good, usable and poor for, without the reasons, in one sentence."""
        by_grade: dict[Grade, list[str]] = {}
        for grade in GRADES:
            if words := [PURPOSE_WORDS[name] for name, judged in self.purposes.items() if judged.grade == grade]:
                by_grade[grade] = words
        return " ".join(f"{_for(grade, words)}." for grade, words in by_grade.items())

    @property
    def lines(self) -> list[str]:
        """Lines for the terminal: the headline, what it rests on, purposes, the worst joints, checks."""
        reasons = [
            f"  {PURPOSE_WORDS[purpose]}: {_graded(judged.grade)}, because {judged.because}"
            for purpose, judged in self.purposes.items()
        ]
        worst = [
            f"  {joint.joint}: {_graded(joint.grade)}, because {joint.because}"
            for joint in self.joints
            if joint.grade != "good"
        ]
        return [
            self.headline,
            *([self.basis] if self.basis else []),
            *reasons,
            *worst,
            *(f"{check.severity}: {check.text} [{check.name}]" for check in self.checks),
        ]

    def __repr__(self) -> str:
        return f"<dynid.Verdict: {self.headline}>"

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


def judge(checks: Iterable[Check], evidence: Evidence | None, basis: str = "") -> Verdict:
    """The verdict on a model, or on a recording that nothing was identified from yet.

    A purpose is as good as the held-out errors allow, and at best `usable` (`poor`) where a warning (a serious check)
    spoils it. So one more check never improves a purpose, and a purpose that is spoilt is never good.

    Args:
        checks: that were raised.
        evidence: the model on held-out data; None for a recording.
        basis: what they rest on, in words.
    """
    ordered = _most_serious_first(checks)
    joints = () if evidence is None else _joints(ordered, evidence)
    purposes = {purpose: _purpose(purpose, ordered, evidence) for purpose in PURPOSES}
    return Verdict(_headline(purposes, joints), purposes, joints, ordered, basis)


def together(verdicts: Sequence[tuple[str, Verdict]]) -> Verdict:
    """One verdict from several, each with its label: the worst of every purpose and of every joint.

    Raises:
        ValueError: there is none.
    """
    if not verdicts:
        raise ValueError("no verdicts to combine")
    if len(verdicts) == 1:
        return verdicts[0][1]
    purposes = {}
    for purpose in PURPOSES:
        judged = [(label, verdict.purposes[purpose]) for label, verdict in verdicts]
        label, worst = max(judged, key=lambda labelled: GRADES.index(labelled[1].grade))
        purposes[purpose] = replace(worst, because=_on(label, worst.because, (each.because for _, each in judged)))
    by_joint: dict[str, list[tuple[str, JointVerdict]]] = {}
    for label, verdict in verdicts:
        for joint in verdict.joints:
            by_joint.setdefault(joint.joint, []).append((label, joint))
    joints = {}
    for name, of_joint in by_joint.items():
        label, joint = max(of_joint, key=lambda labelled: _badness(labelled[1]))
        joints[name] = replace(joint, because=_on(label, joint.because, (each.because for _, each in of_joint)))
    checks = _most_serious_first(check for _, verdict in verdicts for check in verdict.checks)
    basis = " ".join(dict.fromkeys(verdict.basis for _, verdict in verdicts if verdict.basis))
    worst_first = tuple(sorted(joints.values(), key=lambda joint: _negative(_badness(joint))))
    return Verdict(_headline(purposes, worst_first), purposes, worst_first, checks, basis)


def _on(label: str, because: str, reasons: Iterable[str]) -> str:
    """The reason of the worst, with its label where not all have this reason."""
    return because if all(reason == because for reason in reasons) else f"on {label} {because}"


def _most_serious_first(checks: Iterable[Check]) -> tuple[Check, ...]:
    """Each once."""
    return tuple(sorted(dict.fromkeys(checks), key=lambda check: -SEVERITIES.index(check.severity)))


def _joints(checks: Sequence[Check], evidence: Evidence) -> tuple[JointVerdict, ...]:
    """Every joint, worst first."""
    judged = []
    for joint, error in evidence.joints.items():
        reasons = [_check_reason(check) for check in checks if joint in check.joints and check.severity != "note"]
        figure = error.judged
        if figure is not None:
            grade = _grade(figure, GOOD_JOINT_ERROR, USABLE_JOINT_ERROR)
            reasons.append(_Reason(grade, f"its held-out error is {error.text}"))
        worst = _worst(reasons) if reasons else _Reason("usable", "its held-out error is unknown")
        judged.append(JointVerdict(joint, worst.grade, worst.text, known(error.all_samples)))
    return tuple(sorted(judged, key=lambda joint: _negative(_badness(joint))))


def _purpose(purpose: Purpose, checks: Sequence[Check], evidence: Evidence | None) -> PurposeVerdict:
    """The worst of its reasons: checks first, then errors. Where all is good, the error is the reason."""
    reasons = [_check_reason(check) for check in checks if purpose in check.purposes]
    if evidence is not None:
        simulated = purpose == "simulation" and evidence.motions
        reasons += _simulation_reasons(evidence) if simulated else _torque_reasons(evidence)
        if purpose == "simulation" and not simulated and evidence.whole.judged is not None:
            reasons.append(_Reason("usable", "its motion was not simulated"))
    worst = _worst(reasons or [_Reason("good", "no check failed")])
    return PurposeVerdict(worst.grade, worst.text)


def _simulation_reasons(evidence: Evidence) -> list[_Reason]:
    """Reasons of the simulated motion and of the torque error in motion: at rest a simulation has its own stiction."""
    reasons = []
    for motion in evidence.motions:
        others = [
            f"{rounded(other.whole)} times in the {other.text}" for other in evidence.motions if other is not motion
        ]
        reasons += _motion_reasons(motion, f" ({'; '.join(others)})" if others else "")
    moving = known(evidence.whole.all_samples if evidence.whole.in_motion is None else evidence.whole.in_motion)
    if moving is None:
        return [*reasons, _Reason("usable", "no held-out torque error is known")]
    grade = _grade(moving, GOOD_ERROR, USABLE_ERROR)
    return [*reasons, _Reason(grade, f"the held-out torque error in motion is {percent_text(moving, 2)}")]


def _torque_reasons(evidence: Evidence) -> list[_Reason]:
    """Reasons of the whole arm's error, and of that of the joint with the largest."""
    whole = evidence.whole.judged
    if whole is None:
        return [_Reason("usable", "no held-out error is known")]
    reasons = [_Reason(_grade(whole, GOOD_ERROR, USABLE_ERROR), f"the held-out torque error is {evidence.whole.text}")]
    figures = {joint: error.judged for joint, error in evidence.joints.items()}
    largest = max(figures, key=lambda joint: figures[joint] or 0.0, default=None)
    if largest is not None and (figure := figures[largest]) is not None:
        grade = _grade(figure, GOOD_JOINT_ERROR, USABLE_JOINT_ERROR)
        reasons.append(_Reason(grade, f"the held-out torque error of {largest} is {evidence.joints[largest].text}"))
    return reasons


def _motion_reasons(motion: MotionError, beside: str) -> list[_Reason]:
    """Reasons of the whole arm's simulated motion, and of the worst joint's; `beside` says what else was simulated."""
    joint = motion.worst
    against = "times that of constant velocity"
    return [
        _Reason(
            _grade(motion.whole, GOOD_MOTION, USABLE_MOTION),
            f"the error of the {motion.text} is {motion.whole:.2g} {against}{beside}",
        ),
        _Reason(
            _grade(motion.joints[joint], GOOD_JOINT_MOTION, USABLE_JOINT_MOTION),
            f"the error of {joint} in the {motion.text} is {motion.errors[joint]}, {motion.joints[joint]:.2g} "
            f"{against}",
        ),
    ]


def _check_reason(check: Check) -> _Reason:
    kind = CATALOGUE.get(check.name)
    if kind is not None and kind.figures:
        return _Reason(AT_BEST[check.severity], check.text.partition("; ")[0])
    who = f" ({', '.join(check.joints)})" if check.joints else ""
    return _Reason(AT_BEST[check.severity], f"{kind.meaning}{who}" if kind is not None else check.text)


def _worst(reasons: Sequence[_Reason]) -> _Reason:
    """The first of the worst."""
    return max(reasons, key=lambda reason: GRADES.index(reason.grade))


def _grade(error: float, good: float, usable: float) -> Grade:
    return "good" if error < good else "usable" if error < usable else "poor"


def _badness(joint: JointVerdict) -> tuple[int, float]:
    return GRADES.index(joint.grade), joint.error if joint.error is not None else -1.0


def _negative(badness: tuple[int, float]) -> tuple[int, float]:
    return -badness[0], -badness[1]


def _headline(purposes: dict[Purpose, PurposeVerdict], joints: Sequence[JointVerdict]) -> str:
    """Return what the model is good, usable and poor for, each with its reason; the worst joint if it is not good."""
    sentences = []
    for grade in GRADES:
        by_reason: dict[str, list[str]] = {}
        for purpose in PURPOSES:
            if purposes[purpose].grade == grade:
                by_reason.setdefault(purposes[purpose].because, []).append(PURPOSE_WORDS[purpose])
        sentences += [f"{_for(grade, words)}, because {because}." for because, words in by_reason.items()]
    worst = joints[0] if joints else None
    if worst is not None and (worst.grade == "poor" or (worst.grade == "usable" and worst.error is not None)):
        sentences.append(f"Worst joint: {worst.joint}, {_graded(worst.grade)}, because {worst.because}.")
    return " ".join(sentences)


def _for(grade: Grade, words: Sequence[str]) -> str:
    text = f"{_graded(grade)}{',' if grade == 'usable' else ''} for {_listed(words)}"
    return text[0].upper() + text[1:]


def _graded(grade: Grade) -> str:
    return "usable, not good" if grade == "usable" else grade


def _listed(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"
