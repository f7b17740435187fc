"""Two identified models side by side in one call."""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike
from typing import TYPE_CHECKING

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.errors import UsageError
from drivers.core.text import in_percent
from ident.assessment.validation import Fit
from ident.regression.estimate import Estimate
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT, SignificanceTest, chi_square_test
from ident.result.models.model import Model, result_path
from ident.result.result_file import SERVO, kind_of, stored_estimate, stored_model
from ident.result.schema import Result
from ident.result.tables import Cell, Table, table_of_rows
from ident.servo.result import (
    ServoResult,
    error_differences,
    parameter_differences,
    parameters_agree,
    read_servo_result,
    refuse_other_arm,
)
from ident.tasks.arguments import GradedResult, ShownResult
from ident.tasks.identification import IdentificationResult
from ident.tasks.validation import result_of
from ident.verdict.check import PURPOSE_WORDS

if TYPE_CHECKING:
    from ident.tasks.servo import ServoModel


@dataclass(frozen=True)
class ModelDifference(ShownResult):
    """Two models of one arm side by side; the columns `first` and `second` are the models."""

    # base parameters as estimated, with σ, the difference second − first, and z, the difference over its σ; empty where
    # a model has no value or no σ
    parameters: Table
    errors: Table  # held-out errors of each joint, and of all together
    purposes: Table  # grade of each purpose
    checks: Table  # severity of each check that one of the two raises; empty where a model does not raise it
    # of all parameters together, with both covariances: chi-square, its degrees of freedom, and the probability of a
    # larger one if the arm is the same; None where a covariance is not stored
    test: SignificanceTest | None
    # recordings that both were identified from, by file name; their errors are then not independent
    shared: tuple[str, ...]
    what: str = "base parameters"  # the parameters, in words

    @property
    def agree(self) -> bool | None:
        """Return whether the parameters agree within their errors (p ≥ 0.01); None where that is not known."""
        return None if self.test is None else self.test.passed

    @property
    def headline(self) -> str:
        """The comparison of the parameters in a sentence or two."""
        scores = self.parameters["z"]
        beyond = int(np.sum(np.abs(scores) > WITHIN_95_PERCENT))
        compared = int(np.sum(np.isfinite(scores)))
        text = f"{beyond} of {compared} {self.what} differ by more than {WITHIN_95_PERCENT:g} σ"
        if self.test is None:
            text += "; together they cannot be tested, since a covariance is missing."
        else:
            words = "agree" if self.agree else "differ significantly"
            text += (
                f"; together they {words} (chi-square {self.test.statistic:.3g} for {self.test.freedom} parameters, "
                f"{self.test.p_text})."
            )
        if self.shared:
            text += f" Both were identified from {', '.join(self.shared)}: their errors are not independent."
        return text

    def __repr__(self) -> str:
        return f"<dynid.ModelDifference: {self.headline}>"

    def _parts(self) -> tuple[object, ...]:
        tables = self.parameters, self.errors, self.purposes, self.checks
        return self.headline, *(table for table in tables if len(table))


def diff(
    first: IdentificationResult | Model | ServoModel | str | PathLike[str],
    second: IdentificationResult | Model | ServoModel | str | PathLike[str],
) -> ModelDifference:
    """Compare two models of one arm, or two servo models: parameters with z-scores, held-out errors, checks.

    Args:
        first: a result, a model, or the folder or file of one.
        second: the same of the other.

    Raises:
        UsageError: other robots, joints or base parameters; a servo model and one of torques.
        ResultFileError: no result, or its parts do not belong together.

    Example:
        >>> import dynid
        >>> one, other = (dynid.identify(dynid.simulate("ur5e", duration=10.0, seed=seed)) for seed in (1, 2))
        >>> difference = dynid.diff(one, other)
        >>> difference.agree, abs(difference.parameters.row("Fv1")["z"]) < 5
        (True, True)
    """
    servos = [_servo_result(given) for given in (first, second)]
    if servos[0] is not None and servos[1] is not None:
        return _servo_difference(servos[0], servos[1])
    if any(servos):
        raise UsageError("a servo model cannot be compared with a model of torques")
    first_result, second_result = result_of(first), result_of(second)  # type: ignore[arg-type]
    _check_comparable(first_result, second_result)
    return ModelDifference(
        parameters=_parameters(first_result, second_result),
        errors=_errors(first_result, second_result),
        purposes=_purposes(first_result, second_result),
        checks=_checks(first_result, second_result),
        test=_test(first_result, second_result),
        shared=_shared(first_result, second_result),
    )


def _servo_result(given: object) -> ServoResult | None:
    """The result of a servo model, read where a path is given; None of anything else."""
    if isinstance(given, GradedResult):
        return given.result if isinstance(given.result, ServoResult) else None
    if isinstance(given, (str, PathLike)) and kind_of(path := result_path(given)) == SERVO:
        return read_servo_result(path)
    return None


def _servo_difference(first: ServoResult, other: ServoResult) -> ModelDifference:
    refuse_other_arm(first, other)
    grades = [["simulation", first.verdict.grade, other.verdict.grade]]
    checks = [result.verdict.checks for result in (first, other)]
    raised = [
        [check, *("raised" if check in own else None for own in checks)]
        for check in dict.fromkeys(checks[0] + checks[1])
    ]
    return ModelDifference(
        parameters=parameter_differences(first, other),
        errors=error_differences(first, other),
        purposes=table_of_rows("Verdict", [(name, "") for name in ("purpose", "first", "second")], grades),
        checks=table_of_rows("Checks", [(name, "") for name in ("check", "first", "second")], raised),
        test=parameters_agree(first, other),
        shared=_shared(first, other),
        what="servo parameters",
    )


def _check_comparable(first: Result, other: Result) -> None:
    if first.robot != other.robot:
        raise UsageError(f"the models are of different robots: {first.robot} and {other.robot}")
    if first.joints != other.joints:
        raise UsageError(f"the models have different joints: {', '.join(first.joints)}; {', '.join(other.joints)}")
    texts = [{entry.name: entry.expression for entry in result.base_parameters} for result in (first, other)]
    apart = [name for name in {**texts[0], **texts[1]} if texts[0].get(name) != texts[1].get(name)]
    if apart:
        raise UsageError(
            f"the models have different base parameters ({', '.join(apart[:5])}{', …' if len(apart) > 5 else ''})",
            hint="identify both with the same joints moving, the same geometry and the same friction columns",
        )


def _parameters(first: Result, other: Result) -> Table:
    second = {entry.name: entry for entry in other.base_parameters}
    rows: list[tuple[Cell, ...]] = []
    for entry in first.base_parameters:
        twin = second[entry.name]
        difference = None if entry.value is None or twin.value is None else twin.value - entry.value
        variance = None if entry.std is None or twin.std is None else entry.std**2 + twin.std**2
        score = None if difference is None or not variance else difference / variance**0.5
        rows.append((entry.name, entry.value, entry.std, twin.value, twin.std, difference, score, entry.unit))
    names = ("name", "first", "first_std", "second", "second_std", "difference", "z", "unit")
    return table_of_rows(f"Base parameters of {first.robot}", [(name, "") for name in names], rows)


def _errors(first: Result, other: Result) -> Table:
    fits = tuple(result.delivered.validation_all_samples for result in (first, other))
    rows: list[tuple[Cell, ...]] = [
        (
            joint,
            *(_entry(fit, "rmse", i) for fit in fits),
            *(in_percent(_entry(fit, "joint_relative_error", i)) for fit in fits),
        )
        for i, joint in enumerate(first.joints)
    ]
    rows.append(("all", None, None, *(in_percent(None if fit is None else fit.relative_error) for fit in fits)))
    unit = first.unit("N·m")
    headings = [("joint", ""), ("first_rmse", unit), ("second_rmse", unit), ("first", "%"), ("second", "%")]
    return table_of_rows(f"Held-out errors: {first.validation_source}; {other.validation_source}", headings, rows)


def _entry(fit: Fit | None, quantity: str, joint: int) -> float | None:
    values: list[float | None] = [] if fit is None else getattr(fit, quantity)
    return values[joint] if joint < len(values) else None


def _purposes(first: Result, other: Result) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for purpose, words in PURPOSE_WORDS.items():
        judged = [result.verdict.purposes.get(purpose) for result in (first, other)]
        rows.append((words, *(None if difference is None else difference.grade for difference in judged)))
    return table_of_rows("Verdict", [(name, "") for name in ("purpose", "first", "second")], rows)


def _checks(first: Result, other: Result) -> Table:
    severities = [{check.name: check.severity for check in result.verdict.checks} for result in (first, other)]
    rows: list[tuple[Cell, ...]] = [
        (name, severities[0].get(name), severities[1].get(name)) for name in {**severities[0], **severities[1]}
    ]
    return table_of_rows("Checks", [(name, "") for name in ("check", "first", "second")], rows)


def _test(result: Result, other: Result) -> SignificanceTest | None:
    """Test whether the parameters that both estimate with a known variance differ significantly.

    Where the jackknives have too few blocks for the test, their variances count by their mean alone, as in merging.
    """
    from scipy.special import chdtrc

    if result.estimate is None or other.estimate is None:
        return None
    estimates = [stored_estimate(each, stored_model(each)) for each in (result, other)]
    places = [_known_places(estimate) for estimate in estimates]
    common = [column for column in places[0] if column in places[1]]
    if not common:
        return None
    chosen = [[of_columns[column] for column in common] for of_columns in places]
    first, second = (estimate.values[places] for estimate, places in zip(estimates, chosen, strict=True))
    parts = list(zip(estimates, chosen, strict=True))
    total = sum(estimate.covariance[np.ix_(places, places)] for estimate, places in parts)
    test = chi_square_test(second - first, np.asarray(total), min(estimate.blocks for estimate in estimates))
    if test is not None:
        return test
    scaled = np.asarray(sum(_scaled_covariance(estimate)[np.ix_(places, places)] for estimate, places in parts))
    statistic = float((second - first) @ np.linalg.solve(scaled, second - first))
    return SignificanceTest(statistic, len(common), float(chdtrc(len(common), statistic)))


def _known_places(estimate: Estimate) -> dict[int, int]:
    """Column → its place in the estimate, of values whose variance is known."""
    finite = np.isfinite(np.diag(estimate.covariance))
    return {column: place for place, column in enumerate(estimate.active) if finite[place]}


def _scaled_covariance(estimate: Estimate) -> FloatArray:
    """(a, a) for white residuals, times the mean ratio of the corrected variance to it."""
    finite = np.isfinite(np.diag(estimate.covariance))
    root = estimate.root[:, finite]
    ratio = float(np.trace(root @ estimate.covariance[np.ix_(finite, finite)] @ root.T)) / int(finite.sum())
    inverse = np.linalg.inv(estimate.root)
    return np.asarray(ratio * (inverse @ inverse.T))


def _shared(first: Result | ServoResult, other: Result | ServoResult) -> tuple[str, ...]:
    used = {use.sha256 for use in other.recordings if use.role == "identification"}
    return tuple(use.file for use in first.recordings if use.role == "identification" and use.sha256 in used)
