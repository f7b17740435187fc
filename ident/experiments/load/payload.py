"""The load on an arm's tool, from a run without and a run with it (SR400 .4.4, its load relations and Table 4).

Both runs are one weighted least-squares problem: they share the base parameters x, and the load's columns are in the
loaded run's rows only,

    [W_free        0      ] [x]   [τ_free  ]
    [W_loaded  W_loaded·E ] [π] = [τ_loaded]        E = effect of the load on the base parameters (`ident.model.load`)

Error bars come from the delete-block jackknife. The drive gains' uncertainty comes on top: the solution is linear in
the torques, so a relative error ε_j of joint j's gain moves it by ε_j times what that joint's torque contributed.

Whether a load explains the change from one run to the other is tested on the base parameters that a load changes,
identified from each run separately. Their difference d has a covariance that is itself estimated from B blocks, so the
chi-square statistic dᵀC⁻¹d is compared with Hotelling's T² distribution, which tends to chi-square for many blocks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass as stored

from daq.recording.recording import Recording
from daq.robot.loader import RobotFile
from drivers.core.arrays import FloatArray
from drivers.core.text import percent_text
from ident.experiments.load.consistent_load import ConsistentLoad, consistent_load
from ident.experiments.load.load_estimate import (
    LoadEstimate,
    SeparateRuns,
    change_between,
    estimate_load,
    identify_separately,
)
from ident.experiments.run_pair import FREE, LOADED, RunPair, pair_warnings, prepare_pair
from ident.model.load import INDEPENDENT, KnownLoad, load_effect
from ident.model.parameters import MASS
from ident.regression.hypothesis_tests import SignificanceTest, chi_square_test
from ident.regression.jackknife import jackknife_covariance
from ident.result.units import parameter_unit
from ident.signals.joint_signals import read_joint_signals
from ident.stored import Real, Stored

NEGLIGIBLE_SHARE = 0.002
"""A mass within this share of the known one is as good as it, however little noise there is."""


class BaseParameterChange(Stored):
    """A base parameter that a load changes, as in SR400 Table 4."""

    name: str
    unit: str
    free: Real = Field(description="identified from the free run")
    free_std: Real
    predicted: Real = Field(description="free plus the effect of the load")
    loaded: Real = Field(description="identified from the loaded run")
    loaded_std: Real


@stored(frozen=True)
class LargestChange(SignificanceTest):
    """The base parameter that changed most between the runs, of those that a load does not change.

    Its difference is tested as the largest of so many (Bonferroni); the statistic is its square in variances.
    """

    worst: str  # its name
    unit: str  # its unit
    # free, loaded: identified from each run
    free: float
    loaded: float


@dataclass(frozen=True)
class PayloadTests:
    """Tests of a load; None where there is nothing to test, or too little data for it."""

    mass: SignificanceTest | None  # known against identified mass, noise only
    # all known against identified load parameters, noise only; None where the mass alone is known
    values: SignificanceTest | None
    load: SignificanceTest | None  # whether some load explains what changed
    known_load: SignificanceTest | None  # whether the known load does; None where not all ten parameters are known
    unchanged: LargestChange | None  # the largest difference of what a load does not change (friction, motor inertia)


@dataclass(frozen=True)
class Payload:
    """Load identified from two runs, and tests of it."""

    pair: RunPair  # the runs
    load: LoadEstimate  # estimate without any knowledge of the load
    with_mass: LoadEstimate | None  # estimate with what is known as a constraint; None where nothing is
    # the load as a body that can exist, what is known held fixed; None where no minimum was reached
    consistent: ConsistentLoad | None
    tests: PayloadTests  # of the load, and of what it does not change
    changes: tuple[BaseParameterChange, ...]  # base parameters without, predicted and identified with the load
    # blocks, block_length: of the jackknife
    blocks: int
    block_length: int
    warnings: tuple[str, ...]  # for the user


def identify_payload(
    free: Recording,
    loaded: Recording,
    known: KnownLoad | None = None,
    robot_file: RobotFile | None = None,
    delay: float | None = None,
) -> Payload:
    """The load that a loaded run carries and a free run does not.

    Args:
        free: recording without the load.
        loaded: recording of the same arm with it.
        known: known parameters of the load; None where there are none.
        robot_file: in place of the free recording's.
        delay: of the torque [s]; searched where None.

    Raises:
        DataError: different arms, no torque, no load column that the motions could show.
        IdentificationError: the system has no solution.
        RobotFileError: the file's `known` values are impossible, alone or together.
    """
    pair = prepare_pair(free, loaded, read_joint_signals, robot_file, delay)
    effect = load_effect(pair.model, pair.base, pair.robot_file.robot)
    separate, grams = identify_separately(pair)
    estimate = estimate_load(pair, grams, effect, separate.weights, None)
    constrained = None if known is None else estimate_load(pair, grams, effect, separate.weights, known)
    used = estimate if constrained is None else constrained
    load_parameters = np.where(np.isfinite(used.values), used.values, 0.0)
    shift = used.columns.effect @ load_parameters + (0.0 if known is None else effect @ known.values)
    changing, rest = _changing(effect, separate.active)
    difference, covariance = change_between(separate)
    position = {column: place for place, column in enumerate(separate.active)}
    rows, others = [position[i] for i in changing], [position[i] for i in rest]
    blocks = grams.count
    deviations = [np.sqrt(np.diag(jackknife_covariance(moves))) for moves in separate.moves]
    known_test = None
    if known is not None and len(known.known) == 10:
        left = difference - (effect @ known.values)[list(separate.active)]
        known_test = chi_square_test(left[rows], covariance[np.ix_(rows, rows)], blocks)
    payload = Payload(
        pair=pair,
        load=estimate,
        with_mass=constrained,
        consistent=consistent_load(pair, estimate, known),
        tests=PayloadTests(
            mass=_mass_test(estimate, known),
            values=_values_test(estimate, known, blocks),
            load=chi_square_test(difference[rows], covariance[np.ix_(rows, rows)], blocks, effect[list(changing)]),
            known_load=known_test,
            unchanged=_largest_change(pair, separate, difference, covariance, others, blocks),
        ),
        changes=tuple(
            BaseParameterChange(
                name=pair.base.names[column],
                unit=parameter_unit(pair.model, pair.base.columns[column]),
                free=separate.parameters[FREE][column],
                free_std=deviations[FREE][row],
                predicted=(separate.parameters[FREE] + shift)[column],
                loaded=separate.parameters[LOADED][column],
                loaded_std=deviations[LOADED][row],
            )
            for column, row in zip(changing, rows, strict=True)
        ),
        blocks=blocks,
        block_length=grams.length,
        warnings=(),
    )
    return replace(payload, warnings=tuple(_warnings(payload, (free, loaded))))


def _largest_change(
    pair: RunPair,
    separate: SeparateRuns,
    difference: FloatArray,
    covariance: FloatArray,
    places: Sequence[int],
    blocks: int,
) -> LargestChange | None:
    """The largest difference among the active parameters at `places`, in standard deviations."""
    from scipy.special import stdtr

    spread = np.sqrt(np.diag(covariance))
    with_error_bars = [place for place in places if spread[place] > 0]
    if not with_error_bars:
        return None
    worst = max(with_error_bars, key=lambda place: abs(float(difference[place] / spread[place])))
    size = abs(float(difference[worst] / spread[worst]))
    p_value = min(1.0, len(with_error_bars) * 2.0 * float(stdtr(blocks - 1, -size)))
    parameter = separate.active[worst]
    free, loaded = (float(values[parameter]) for values in separate.parameters)
    unit = parameter_unit(pair.model, pair.base.columns[parameter])
    return LargestChange(size**2, 1, p_value, pair.base.names[parameter], unit, free, loaded)


def _changing(effect: FloatArray, active: tuple[int, ...]) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Indices of the active base parameters that a load changes, and of the others."""
    changes = np.any(np.abs(effect) > INDEPENDENT, axis=1)
    return tuple(i for i in active if changes[i]), tuple(i for i in active if not changes[i])


def _mass_test(estimate: LoadEstimate, known: KnownLoad | None) -> SignificanceTest | None:
    if known is None or not np.isfinite(estimate.standard[MASS]):
        return None
    from scipy.special import chdtrc

    place = estimate.columns.kept.index(MASS)
    statistic = float((estimate.standard[MASS] - known.mass) ** 2 / estimate.covariance[place, place])
    return SignificanceTest(statistic, 1, float(chdtrc(1, statistic)))


def _values_test(estimate: LoadEstimate, known: KnownLoad | None, blocks: int) -> SignificanceTest | None:
    if known is None or len(known.known) < 2:
        return None
    places = [
        place
        for place, parameter in enumerate(estimate.columns.kept)
        if parameter in known.known and np.isfinite(estimate.standard[parameter])
    ]
    kept = [estimate.columns.kept[place] for place in places]
    return chi_square_test(
        estimate.standard[kept] - known.values[kept], estimate.covariance[np.ix_(places, places)], blocks
    )


def _warnings(payload: Payload, recordings: tuple[Recording, Recording]) -> list[str]:
    warnings = pair_warnings(payload.pair, recordings)
    if payload.load.unexcited:
        warnings.append(
            f"the two motions do not excite {', '.join(payload.load.unexcited)}: they get no value, and other "
            "parameters may have absorbed them"
        )
    mass, known = payload.load.standard[MASS], payload.load.known or (payload.with_mass and payload.with_mass.known)
    if (
        payload.tests.mass is not None
        and known
        and not payload.tests.mass.passed
        and abs(mass / known.mass - 1) > NEGLIGIBLE_SHARE
    ):
        warnings.append(
            f"the identified mass is {percent_text(abs(mass / known.mass - 1), 2)} "
            f"{'above' if mass > known.mass else 'below'} the known one, which noise does not explain: if the load was "
            "weighed right, drive gains are off by about as much; identify them with dynid gains"
        )
    place = payload.load.columns.kept.index(MASS) if MASS in payload.load.columns.kept else None
    if place is not None and np.isfinite(mass) and mass < 2 * np.sqrt(payload.load.covariance[place, place]):
        warnings.append("no load detected: the identified mass is below 2 σ")
    if payload.tests.load is not None and not payload.tests.load.passed:
        warnings.append(
            "the runs do not differ as a load on the last link would make them differ: it slips, a hose pulls, it "
            "touches something, or the drive gains are wrong"
        )
    body = payload.consistent
    if body is None:
        warnings.append("no physically consistent load and links were found: check units, gains and geometry")
    elif body.test is not None and not body.test.passed:
        warnings.append(
            "no physically consistent load and links explain the runs: check gains, geometry and known values"
        )
    if body is not None and body.rounded:
        warnings.append(
            "no body has exactly the known inertia (a rounded table?): that of the consistent load was estimated"
        )
    if payload.tests.unchanged is not None and not payload.tests.unchanged.passed:
        warnings.append(
            "friction or motor inertia changed between the runs, which a load does not change: warm the arm up before "
            "both, or check the drive gains"
        )
    return warnings
