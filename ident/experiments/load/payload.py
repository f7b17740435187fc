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
from dataclasses import dataclass
from math import isfinite
from typing import Literal

import numpy as np
from pydantic import Field, computed_field
from pydantic.dataclasses import dataclass as stored

from daq.recording.recording import Recording
from daq.robot.loader import RobotFile
from drivers.core.arrays import FloatArray
from drivers.core.text import counted, percent_text
from ident.assessment.delay.delay import DelaySearch
from ident.experiments.load.consistent_load import ConsistentLoad, consistent_load
from ident.experiments.load.load_estimate import (
    CentreOfMass,
    LoadEstimate,
    LoadParameter,
    SeparateRuns,
    change_between,
    estimate_load,
    identify_separately,
)
from ident.experiments.run_pair import FREE, LOADED, RunPair, pair_warnings, prepare_pair
from ident.model.load import INDEPENDENT, KnownLoad, load_effect
from ident.model.parameters import INERTIAL, MASS
from ident.regression.hypothesis_tests import LEVEL, WITHIN_95_PERCENT, SignificanceTest, chi_square_test
from ident.regression.jackknife import jackknife_covariance
from ident.result.units import parameter_unit
from ident.signals.joint_signals import read_joint_signals
from ident.stored import Real, Stored

FRAME_TEXT = "tool frame: origin at workspace.tool, axes of the last joint's frame"

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


class Payload(Stored):
    """The load identified from a free and a loaded run, and tests of it."""

    kind: Literal["payload"] = "payload"
    robot: str
    runs: list[str] = Field(description="free, loaded")
    frame: str = FRAME_TEXT
    load: list[LoadParameter] = Field(description="without any knowledge of the load")
    load_with_known: list[LoadParameter] | None = Field(
        description="known values held fixed; null where there are none"
    )
    consistent_load: ConsistentLoad | None = Field(
        description="the load as a body that can exist, known values held fixed; null where no minimum was reached"
    )
    centre_of_mass: CentreOfMass | None
    not_identifiable: list[str]
    unexcited: list[str]
    known: KnownLoad | None
    base_parameters: list[BaseParameterChange] = Field(description="without, predicted and identified with the load")
    tests: PayloadTests
    delay: DelaySearch
    blocks: int = Field(description="of the jackknife")
    block_length: int = Field(description="samples per block")
    warnings: list[str]

    @property
    def mass(self) -> LoadParameter | None:
        """The mass, identified without any knowledge of the load; None where only a combination is identifiable."""
        return next((row for row in self.load if row.name == "M_L" and isfinite(row.value)), None)

    @computed_field(description="the tests in words")  # type: ignore[prop-decorator]
    @property
    def sentences(self) -> list[str]:
        """The tests in words."""
        tests, sentences = self.tests, []
        if tests.mass is not None and self.known is not None and self.mass is not None:
            sentences.append(_mass_sentence(self.mass, self.known.mass, tests.mass))
        if tests.values is not None:
            subject = "the identified load parameters"
            sentences.append(_sentence(tests.values, subject, "agree", "with all the known ones", ""))
        sentences.append(
            _sentence(
                tests.load,
                "the runs",
                "differ",
                "as a load on the last link would make them differ",
                "whether a load explains the change",
            )
        )
        if self.known is not None and len(self.known.known) == len(INERTIAL):
            sentences.append(
                _sentence(
                    tests.known_load,
                    "the free run's base parameters plus the known load",
                    "agree",
                    "with those identified loaded",
                    "whether the known load explains the change",
                )
            )
        rest = tests.unchanged
        if rest is not None:
            stayed = "stayed" if rest.passed else "did not stay"
            sentences.append(
                f"what a load does not change (friction, motor inertia, …) {stayed} the same: the largest difference "
                f"is {rest.worst}'s, from {rest.free:.4g} to {rest.loaded:.4g} {rest.unit}, {rest.statistic**0.5:.1f} "
                f"σ ({_p_value_text(rest)})"
            )
        return sentences


def _mass_sentence(mass: LoadParameter, known: float, test: SignificanceTest) -> str:
    verdict = "agrees with" if test.passed else "does not agree with"
    noise, gains = WITHIN_95_PERCENT * mass.noise_std, WITHIN_95_PERCENT * mass.gain_std
    text = f"mass: identified without it, {mass.value:.4g} ± {noise:.2g} kg {verdict} the known {known:g} kg "
    text += f"({_test_text(test)})"
    if not test.passed and abs(mass.value - known) < WITHIN_95_PERCENT * mass.std:
        text += f"; the drive gains' standard deviations in the robot file add ± {gains:.2g} kg, "
        text += "which covers the difference"
    return text


def _sentence(test: SignificanceTest | None, subject: str, verb: str, rest: str, question: str) -> str:
    if test is None:
        return f"{question}: too few blocks of data to decide; record longer, or add other motions"
    return f"{subject} {verb if test.passed else f'do not {verb}'} {rest} ({_test_text(test)})"


def _test_text(test: SignificanceTest) -> str:
    freedom = counted(test.freedom, "degree(s) of freedom")
    return f"χ² = {test.statistic:.1f} with {freedom}, {_p_value_text(test)}"


def _p_value_text(test: SignificanceTest) -> str:
    return test.p_text if test.passed else f"{test.p_text}, significant below {LEVEL:g}"


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
    tests = PayloadTests(
        mass=_mass_test(estimate, known),
        values=_values_test(estimate, known, blocks),
        load=chi_square_test(difference[rows], covariance[np.ix_(rows, rows)], blocks, effect[list(changing)]),
        known_load=known_test,
        unchanged=_largest_change(pair, separate, difference, covariance, others, blocks),
    )
    payload = Payload(
        robot=pair.robot_file.robot.name,
        runs=[run.label for run in pair.runs],
        load=estimate.parameters,
        load_with_known=None if constrained is None else constrained.parameters,
        consistent_load=consistent_load(pair, estimate, known),
        centre_of_mass=used.centre,
        not_identifiable=estimate.columns.not_identifiable,
        unexcited=[row.name for row in estimate.parameters if not isfinite(row.value)],
        known=known,
        base_parameters=[
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
        ],
        tests=tests,
        delay=pair.delay,
        blocks=blocks,
        block_length=grams.length,
        warnings=pair_warnings(pair, (free, loaded)),
    )
    return payload.model_copy(update={"warnings": [*payload.warnings, *_warnings(payload)]})


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


def _warnings(payload: Payload) -> list[str]:
    warnings = []
    if payload.unexcited:
        warnings.append(
            f"the two motions do not excite {', '.join(payload.unexcited)}: they get no value, and other "
            "parameters may have absorbed them"
        )
    mass, known, test = payload.mass, payload.known, payload.tests.mass
    if mass and known and test and not test.passed and abs(mass.value / known.mass - 1) > NEGLIGIBLE_SHARE:
        warnings.append(
            f"the identified mass is {percent_text(abs(mass.value / known.mass - 1), 2)} "
            f"{'above' if mass.value > known.mass else 'below'} the known one, which noise does not explain: if the "
            "load was weighed right, drive gains are off by about as much; identify them with dynid gains"
        )
    if mass and mass.value < 2 * mass.noise_std:
        warnings.append("no load detected: the identified mass is below 2 σ")
    if payload.tests.load is not None and not payload.tests.load.passed:
        warnings.append(
            "the runs do not differ as a load on the last link would make them differ: it slips, a hose pulls, it "
            "touches something, or the drive gains are wrong"
        )
    body = payload.consistent_load
    if body is None:
        warnings.append("no physically consistent load and links were found: check units, gains and geometry")
    elif body.cost is not None and not body.cost.passed:
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
