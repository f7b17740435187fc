"""Acceptance: limits that a user declares for a model, and whether it keeps them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import BeforeValidator, Field, model_validator

from daq.robot.section import Positive, Section
from drivers.core.errors import UsageError
from drivers.core.files import LIMITS_FILE, read_text
from drivers.core.units import joint_unit
from drivers.core.validation import read_mapping, validated
from ident.verdict.check import PURPOSE_WORDS, Purpose
from ident.verdict.verdict import GRADES, Grade, Verdict


def _checked(value: Any) -> Any:
    """One sentence for both forms: pydantic would tell of each by itself."""
    of_joints = value if isinstance(value, dict) else {"": value}
    for joint, limit in of_joints.items():
        number = isinstance(limit, (int, float)) and not isinstance(limit, bool) and math.isfinite(limit)
        if not number or limit <= 0:
            of = f" for {joint}" if joint else ""
            raise ValueError(f"found {limit!r}{of}, but a limit is a number above 0, or a mapping joint: number")
    return value


OfJoints = Annotated[float | dict[str, float], BeforeValidator(_checked)]
"""One limit for every joint, or one for each joint named."""


class AcceptanceLimits(Section):
    """Limits for a model; what is not named is not asked.

    Errors are those of the model that is handed out by default, over all samples, and unknown where a recording is not
    held out.
    """

    relative_error: Positive | None = Field(default=None, description="held-out error of all joints, as a ratio")
    joint_relative_error: OfJoints | None = Field(default=None, description="the same per joint")
    rmse: OfJoints | None = Field(default=None, description="held-out root mean square error per joint [N·m or N]")
    consistent: bool | None = Field(default=None, description="true: physically consistent parameters must exist")
    consistency_cost: Positive | None = Field(
        default=None, description="held-out error of the consistent model over that of the unconstrained one"
    )
    motion_rmse: OfJoints | None = Field(
        default=None, description="motion error per joint of the arm simulated on held-out data [rad or m]"
    )
    purposes: dict[Purpose, Grade] | None = Field(default=None, description="purpose: least grade of the verdict")

    @model_validator(mode="after")
    def _check(self) -> Self:
        for name in ("relative_error", "joint_relative_error"):
            given = getattr(self, name)
            largest = max(given.values(), default=0.0) if isinstance(given, dict) else given or 0.0
            if largest > 1.0:
                raise ValueError(f"{name} {largest:g} is a ratio, not a percentage: 0.08 is 8 %")
        if self.consistent is False:
            raise ValueError("consistent: false requires nothing; omit the key")
        return self

    @property
    def joints(self) -> set[str]:
        """Names of the joints that limits are given for."""
        return {
            name
            for limit in (self.joint_relative_error, self.rmse, self.motion_rmse)
            if isinstance(limit, Mapping)
            for name in limit
        }


@dataclass(frozen=True)
class JudgedLimit:
    """One limit and what came of it.

    Attributes:
        name: key of the limit.
        subject: joint or purpose; empty where it concerns the whole model.
        limit: as declared.
        value: of the model; None where it is not known, which fails.
        passed: whether the limit is kept.
        text: the same in a sentence.
    """

    name: str
    subject: str
    limit: float | str
    value: float | str | None
    passed: bool
    text: str


@dataclass(frozen=True)
class Acceptance:
    """Tells whether a model keeps all declared limits.

    Attributes:
        passed: whether every criterion passed.
        criteria: in the order of the limits' keys.
    """

    passed: bool
    criteria: tuple[JudgedLimit, ...]

    @property
    def lines(self) -> list[str]:
        """Lines for the terminal: the outcome, what failed, how many limits are kept."""
        failed = [criterion for criterion in self.criteria if not criterion.passed]
        kept = len(self.criteria) - len(failed)
        headline = f"Acceptance {'passed' if self.passed else 'FAILED'}: {kept} of {len(self.criteria)} limits kept."
        return [headline, *(f"  {criterion.text}" for criterion in failed)]

    def __str__(self) -> str:
        return "\n".join(self.lines)


@dataclass(frozen=True)
class ModelFigures:
    """What limits are compared with."""

    model: str  # whose errors these are, in words
    relative_error: float | None  # held-out, of all joints; None where not known, as everywhere
    # joint_relative_error, rmse, motion_rmse: by the joint's name
    joint_relative_error: Mapping[str, float | None]
    rmse: Mapping[str, float | None]
    motion_rmse: Mapping[str, float | None]
    sliding: Mapping[str, bool]  # whether a joint slides, by its name
    consistent: bool  # whether physically consistent parameters exist
    consistency_cost: float | None  # held-out error of the consistent model over that of the unconstrained one
    verdict: Verdict  # on the model


def read_limits(path: Path) -> AcceptanceLimits:
    """Read limits from a YAML file.

    Raises:
        UsageError: it cannot be read, or a key is wrong; names file and key.
    """
    where = str(path)
    text = read_text(path, LIMITS_FILE, UsageError)
    content = read_mapping(text, kind="a file of limits", where=where, refusal=UsageError, hint="relative_error: 0.08")
    return declared(content, where)


def declared(content: Mapping[Any, Any], where: str) -> AcceptanceLimits:
    """Limits from a file's keys.

    Raises:
        UsageError: a key is wrong, or there is none.
    """
    limits = validated(content, AcceptanceLimits, where=where, refusal=UsageError)
    if not limits.model_dump(exclude_none=True):
        raise UsageError("states no limit", where=where, hint="relative_error: 0.08")
    return limits


def check_joints(limits: AcceptanceLimits, joints: Sequence[str]) -> None:
    """Refuse limits for joints that the robot has not.

    Raises:
        UsageError: names them.
    """
    unknown = sorted(limits.joints - set(joints))
    if unknown:
        raise UsageError(
            f"limits for {', '.join(unknown)}, which the robot does not have",
            where="accept",
            hint=f"joints: {', '.join(joints)}",
        )


def judge_acceptance(limits: AcceptanceLimits, figures: ModelFigures) -> Acceptance:
    """Compare a model's figures with the limits. A figure that is not known fails; a value at its limit passes."""
    criteria = tuple(_criteria(limits, figures))
    return Acceptance(all(criterion.passed for criterion in criteria), criteria)


def _criteria(limits: AcceptanceLimits, figures: ModelFigures) -> Iterator[JudgedLimit]:
    of_model = f"held-out error of the {figures.model} model"
    if limits.relative_error is not None:
        yield _below("relative_error", "", limits.relative_error, figures.relative_error, of_model, "")
    sliding, torque_words = figures.sliding, f"held-out RMSE of the {figures.model} model"
    ratios = figures.joint_relative_error
    yield from _of_joints("joint_relative_error", limits.joint_relative_error, ratios, of_model, "", sliding)
    yield from _of_joints("rmse", limits.rmse, figures.rmse, torque_words, " N·m", sliding)
    if limits.consistent:
        text = f"physically consistent parameters {'exist' if figures.consistent else 'were not found'}"
        yield JudgedLimit("consistent", "", "yes", "yes" if figures.consistent else "no", figures.consistent, text)
    if limits.consistency_cost is not None:
        words = "held-out error of the consistent model over that of the unconstrained one"
        yield _below("consistency_cost", "", limits.consistency_cost, figures.consistency_cost, words, "")
    motion_words = "simulated motion error"
    yield from _of_joints("motion_rmse", limits.motion_rmse, figures.motion_rmse, motion_words, " rad", sliding)
    for purpose, least in (limits.purposes or {}).items():
        judged = figures.verdict.purposes.get(purpose)
        passed = judged is not None and GRADES.index(judged.grade) <= GRADES.index(least)
        found = "not judged" if judged is None else f"{judged.grade}, {judged.because}"
        text = f"{PURPOSE_WORDS[purpose]}: {found}; at least {least} is required"
        yield JudgedLimit("purposes", purpose, least, None if judged is None else judged.grade, passed, text)


def _of_joints(
    name: str,
    limit: OfJoints | None,
    values: Mapping[str, float | None],
    words: str,
    unit: str,
    sliding: Mapping[str, bool],
) -> Iterator[JudgedLimit]:
    if limit is None:
        return
    of_each = limit if isinstance(limit, dict) else dict.fromkeys(values, limit)
    for joint, own in of_each.items():
        yield _below(name, joint, own, values.get(joint), words, joint_unit(unit, sliding=sliding.get(joint, False)))


def _below(name: str, joint: str, limit: float, value: float | None, words: str, unit: str) -> JudgedLimit:
    finite = value if value is not None and math.isfinite(value) else None
    passed = finite is not None and finite <= limit
    of = f"{joint}: " if joint else ""
    if finite is None:
        text = f"{of}{words} is unknown; the limit is {limit:.4g}{unit}"
    else:
        text = f"{of}{words} is {finite:.4g}{unit}, {'within' if passed else 'above'} the limit of {limit:.4g}{unit}"
    return JudgedLimit(name, joint, limit, finite, passed, text)
