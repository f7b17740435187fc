"""Two servo models of one arm side by side: parameters in the search's coordinates, errors, contacts."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.errors import UsageError
from ident.regression.hypothesis_tests import SignificanceTest
from ident.result.tables import Cell, Table, table_of_rows
from ident.servo.result import ServoResult
from ident.servo.terms import INDEX, TERMS, to_search


def refuse_other_arm(first: ServoResult, other: ServoResult) -> None:
    """Refuse models that are not of one arm.

    Raises:
        UsageError: other robots or joints.
    """
    if first.robot != other.robot:
        raise UsageError(f"the models are of different robots: {first.robot} and {other.robot}")
    if first.joints != other.joints:
        raise UsageError(f"the models have different joints: {', '.join(first.joints)}; {', '.join(other.joints)}")


def parameter_differences(one: ServoResult, other: ServoResult) -> Table:
    """Every parameter of both; σ and z of those that the data of both determine, by their logarithms where positive."""
    points, rows = [to_search(result.values) for result in (one, other)], []
    spreads = [_spread(result) for result in (one, other)]
    for row, name in enumerate(one.joints):
        own = [result.servo[row].parameters for result in (one, other)]
        for term in [term.name for term in TERMS if any(term.name in parameters for parameters in own)]:
            first, second = (parameters[term].value if term in parameters else None for parameters in own)
            sigmas = [spread.get((row, term)) for spread in spreads]
            z: float | None = None
            if sigmas[0] is not None and sigmas[1] is not None:
                apart = points[1][row, INDEX[term]] - points[0][row, INDEX[term]]
                z = float(apart / np.hypot(sigmas[0], sigmas[1]))
            difference = None if first is None or second is None else second - first
            unit = next(parameters[term].unit for parameters in own if term in parameters)
            rows.append([f"{name} {term.replace('_', ' ')}", first, second, difference, z, unit])
    columns = [(heading, "") for heading in ("name", "first", "second", "difference", "z", "unit")]
    return table_of_rows(f"Servo parameters of {one.robot}", columns, rows)


def parameters_agree(first: ServoResult, other: ServoResult) -> SignificanceTest | None:
    """χ² of all parameters that both determine, joint by joint; None where there is none."""
    from scipy.stats import chi2

    statistic, freedom = 0.0, 0
    points = [to_search(result.values) for result in (first, other)]
    known = [set(_spread(result)) for result in (first, other)]
    for row in range(len(first.joints)):
        common = [term.name for term in TERMS if (row, term.name) in known[0] & known[1]]
        if not common:
            continue
        total = np.sum([_covariance(result, row, common) for result in (first, other)], axis=0)
        apart = (points[1] - points[0])[row, [INDEX[term] for term in common]]
        statistic += float(apart @ np.linalg.lstsq(total, apart, rcond=None)[0])
        freedom += len(common)
    return SignificanceTest(statistic, freedom, float(chi2.sf(statistic, freedom))) if freedom else None


def error_differences(first: ServoResult, other: ServoResult) -> Table:
    """Roll-out errors of each joint, of each model's own validation, and what the encoder resolves."""
    shown = [result.validation or result.fit for result in (first, other)]
    unit = "mm" if all(first.sliding) else "mrad, mm" if any(first.sliding) else "mrad"
    parts: list[Sequence[float]] = [fit.rollout_error for fit in shown]
    rows: list[list[Cell]] = [
        [name, *(1e3 * part[row] for part in parts), 1e3 * first.resolution[row]]
        for row, name in enumerate(first.joints)
    ]
    rows.append(["mean", *(1e3 * fit.rollout_mean for fit in shown), None])
    columns = [("joint", ""), ("first", unit), ("second", unit), ("encoder_step", unit)]
    return table_of_rows(f"Roll-out errors: {first.validation_source}; {other.validation_source}", columns, rows)


def _spread(result: ServoResult) -> dict[tuple[int, str], float]:
    """Standard deviations in the search's coordinates of what the data determine, by joint and term."""
    found = {}
    for row, (searched, covariance) in enumerate(zip(result.searched, result.covariance, strict=True)):
        parameters = result.servo[row].parameters
        for place, term in enumerate(searched):
            variance = covariance[place][place]
            if term in parameters and not parameters[term].unidentifiable and variance > 0:
                found[row, term] = float(variance**0.5)
    return found


def _covariance(result: ServoResult, row: int, terms: Sequence[str]) -> FloatArray:
    places = [result.searched[row].index(term) for term in terms]
    return np.array(result.covariance[row], dtype=np.float64)[np.ix_(places, places)]
