"""Results of a free and a loaded run: the tests in words, and the results that `--json` prints."""

from __future__ import annotations

import numpy as np

from drivers.core.text import counted, percent_text
from ident.estimators.feasible.pseudo_inertia import INERTIA_ELEMENTS, body_of
from ident.experiments.gains.drive_gains import DriveGains, drives_text, estimated_values, gain_unit
from ident.experiments.load.consistent_load import ConsistentLoad
from ident.experiments.load.load_estimate import LoadEstimate
from ident.experiments.load.payload import Payload
from ident.experiments.run_pair import RunPair
from ident.experiments.schema import (
    CentreOfMass,
    ConsistentLoadResult,
    GainsResult,
    LinkBody,
    LoadParameter,
    PayloadResult,
    RunError,
)
from ident.model.load import KnownLoad, LoadColumns
from ident.model.parameters import INERTIAL
from ident.regression.hypothesis_tests import LEVEL, WITHIN_95_PERCENT, SignificanceTest
from ident.regression.systematic_errors import gain_deviations
from ident.result.units import parameter_unit

FRAME_TEXT = "tool frame: origin at workspace.tool, axes of the last joint's frame"


def payload_sentences(payload: Payload) -> list[str]:
    """The tests in words."""
    sentences = []
    mass, known = payload.load.standard[INERTIAL.index("M")], _known(payload)
    if payload.tests.mass is not None and known is not None:
        place = payload.load.columns.kept.index(INERTIAL.index("M"))
        noise = float(np.sqrt(payload.load.covariance[place, place]))
        gains = float(gain_deviations(payload.load.gain_moves)[place])
        verdict = "agrees with" if payload.tests.mass.passed else "does not agree with"
        text = (
            f"mass: identified without it, {mass:.4g} ± {WITHIN_95_PERCENT * noise:.2g} kg {verdict} the known "
            f"{known.mass:g} kg ({_test_text(payload.tests.mass)})"
        )
        if not payload.tests.mass.passed and abs(mass - known.mass) < WITHIN_95_PERCENT * np.hypot(noise, gains):
            text += (
                f"; the drive gains' standard deviations in the robot file add ± {WITHIN_95_PERCENT * gains:.2g} kg, "
                "which covers the difference"
            )
        sentences.append(text)
    if payload.tests.values is not None:
        sentences.append(
            _sentence(
                payload.tests.values,
                "the identified load parameters agree with all the known ones",
                "the identified load parameters do not agree with all the known ones",
                "",
            )
        )
    sentences.append(
        _sentence(
            payload.tests.load,
            "the runs differ as a load on the last link would make them differ",
            "the runs do not differ as a load on the last link would make them differ",
            "whether a load explains the change",
        )
    )
    if known is not None and len(known.known) == len(INERTIAL):
        sentences.append(
            _sentence(
                payload.tests.known_load,
                "the free run's base parameters plus the known load agree with those identified loaded",
                "the free run's base parameters plus the known load do not agree with those identified loaded",
                "whether the known load explains the change",
            )
        )
    rest = payload.tests.unchanged
    if rest is not None:
        stayed = "stayed" if rest.passed else "did not stay"
        sentences.append(
            f"what a load does not change (friction, motor inertia, …) {stayed} the same: the largest difference is "
            f"{rest.worst}'s, from {rest.free:.4g} to {rest.loaded:.4g} {rest.unit}, {rest.statistic**0.5:.1f} σ "
            f"({_p_value_text(rest)})"
        )
    return sentences


def _sentence(test: SignificanceTest | None, yes: str, no: str, question: str) -> str:
    if test is None:
        return f"{question}: too few blocks of data to decide; record longer, or add other motions"
    return f"{yes if test.passed else no} ({_test_text(test)})"


def _test_text(test: SignificanceTest) -> str:
    freedom = counted(test.freedom, "degree(s) of freedom")
    return f"χ² = {test.statistic:.1f} with {freedom}, {_p_value_text(test)}"


def _p_value_text(test: SignificanceTest) -> str:
    return test.p_text if test.passed else f"{test.p_text}, significant below {LEVEL:g}"


def load_parameters(estimate: LoadEstimate) -> list[LoadParameter]:
    """One entry per identified combination."""
    columns = zip(
        estimate.columns.names,
        estimate.columns.expressions,
        estimate.columns.units,
        estimate.values.tolist(),
        estimate.std.tolist(),
        np.sqrt(np.diag(estimate.covariance)).tolist(),
        gain_deviations(estimate.gain_moves).tolist(),
        strict=True,
    )
    return [LoadParameter(**dict(zip(LoadParameter.model_fields, column, strict=True))) for column in columns]


def payload_result(payload: Payload) -> PayloadResult:
    """Output of `dynid payload --json`."""
    pair = payload.pair
    centre = (payload.with_mass or payload.load).centre
    return PayloadResult(
        robot=pair.robot_file.robot.name,
        runs=[run.label for run in pair.runs],
        frame=FRAME_TEXT,
        load=load_parameters(payload.load),
        load_with_known=None if payload.with_mass is None else load_parameters(payload.with_mass),
        consistent_load=None if payload.consistent is None else consistent_load_result(pair, payload.consistent),
        centre_of_mass=None if centre is None else CentreOfMass(value=centre[0].tolist(), std=centre[1].tolist()),
        not_identifiable=_regrouped(payload.load.columns),
        unexcited=list(payload.load.unexcited),
        known=_known(payload),
        base_parameters=list(payload.changes),
        tests=payload.tests,
        sentences=payload_sentences(payload),
        delay=pair.delay,
        blocks=payload.blocks,
        block_length=payload.block_length,
        warnings=list(payload.warnings),
    )


def gains_result(drives: DriveGains) -> GainsResult:
    """Output of `dynid gains --json`."""
    pair, base, columns = drives.pair, drives.pair.base, drives.columns
    return GainsResult(
        robot=pair.robot_file.robot.name,
        runs=[run.label for run in pair.runs],
        signal=drives.signal,
        unit=gain_unit(drives.signal, drives.robot),
        known=drives.known,
        gains=list(drives.gains),
        covariance=drives.covariance.tolist(),
        base_parameters=estimated_values(
            base.names, [parameter_unit(pair.model, i) for i in base.columns], drives.parameters, drives.parameter_std
        ),
        load=estimated_values(columns.names, columns.units, drives.load, drives.load_std),
        condition=drives.condition,
        gap=drives.gap,
        delay=pair.delay,
        blocks=drives.blocks,
        block_length=drives.block_length,
        robot_file_text=drives_text(drives.robot, drives.signal, drives.gains),
        warnings=list(drives.warnings),
    )


def _known(payload: Payload) -> KnownLoad | None:
    return None if payload.with_mass is None else payload.with_mass.known


def _regrouped(columns: LoadColumns) -> list[str]:
    """Parameters without their own column: without effect, or regrouped with others."""
    alone = {columns.kept[i] for i in range(len(columns.kept)) if np.count_nonzero(columns.projection[i]) == 1}
    return [f"{symbol}_L" for index, symbol in enumerate(INERTIAL) if index not in alone]


def consistent_load_result(pair: RunPair, load: ConsistentLoad) -> ConsistentLoadResult:
    """The load that can exist, and the arm with it."""
    names = pair.model.link_names
    links = load.loaded_arm.reshape(len(names), len(INERTIAL))
    errors = zip(pair.runs, load.errors, load.consistent_errors, strict=True)
    return ConsistentLoadResult(
        **load.body.figures,
        mass_std=load.mass_std,
        com_std=load.com_std.tolist(),
        inertia_std=dict(zip(INERTIA_ELEMENTS, load.inertia_std.tolist(), strict=True)),
        determined={f"{symbol}_L": float(share) for symbol, share in zip(INERTIAL, load.determined, strict=True)},
        held=[f"{symbol}_L" for symbol, known in zip(INERTIAL, load.known, strict=True) if known],
        on_boundary=load.on_boundary,
        boundary_links=[names[link] for link in load.boundary],
        cost=load.test,
        errors=[RunError(run=run.label, unconstrained=error, consistent=own) for run, error, own in errors],
        links=[LinkBody(link=name, **body_of(link).figures) for name, link in zip(names, links, strict=True)],
    )


def consistent_load_sentences(load: ConsistentLoadResult) -> list[str]:
    """Return what it costs that load and links can exist."""
    errors = "; ".join(
        f"{error.run}: {percent_text(error.unconstrained)} unconstrained, {percent_text(error.consistent)} consistent"
        for error in load.errors
    )
    sentences = [f"relative error of the torque: {errors}"]
    if load.cost is not None:
        cost = load.cost
        verdict = "explains the runs as well" if cost.passed else "does not explain the runs as well"
        sentences.append(
            f"a physically consistent load on consistent links {verdict} as the unconstrained estimate (χ² = "
            f"{cost.statistic:.1f} with {cost.freedom} degrees of freedom, {cost.p_text})"
        )
    held = ["the load"] * load.on_boundary + load.boundary_links
    if held:
        sentences.append(f"on the boundary of physical consistency: {', '.join(held)}")
    return sentences
