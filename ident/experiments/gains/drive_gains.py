"""All drive gains at once, from a run without and a run with a load of known mass (Gautier and Briot 2011, 2014).

Joint torque is gain times motor signal, τ_j = g_j·v_j, so both runs are linear in gains, base parameters and load,

    [V_free    −W_free    0               0         ] [g x π κ]ᵀ = ρ
    [V_loaded  −W_loaded  −W_loaded·E     −W_loaded·E·π_known]

without a right-hand side: the solution is the null vector of the concatenated matrix, known but for its length, and the
known load (κ = 1) fixes that. No gain is presumed.

The noise is in V, the motor signals; that of W, from encoders, is negligible. So total least squares is applied where
the noise is: the columns of W are eliminated exactly, and the smallest singular vector of what remains is used
of V, rows and columns scaled so that its noise is the same everywhere (mixed LS-TLS: Golub, Hoffman and Stewart, Linear
Algebra and its Applications 88, 1987). Ordinary least squares would draw the weakly seen gains towards zero, total
least squares over all columns alike would blame W for the motors' noise.

Each signal's noise is what its own joint's columns leave of it, with free coefficients: this needs no gain. Standard
deviations come from a delete-block jackknife over the whole estimate, so those of the base parameters and of the load
contain those of the gains.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from pydantic import Field, computed_field

from daq.recording.recording import Recording
from daq.robot.loader import RobotFile
from daq.robot.new_robot import quoted
from daq.robot.schema import Robot
from drivers.core.arrays import FloatArray
from drivers.core.text import percentage_text
from drivers.core.units import common_unit
from ident.assessment.delay.delay import DelaySearch
from ident.experiments.gains.gain_system import (
    GainSystem,
    jackknife_moves,
    own_angles,
    signal_of,
    solve_gains,
    system_blocks,
    torques_by,
)
from ident.experiments.run_pair import BlockGrams, RunPair, pair_warnings, prepare_pair
from ident.model.load import KnownLoad
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT
from ident.regression.jackknife import jackknife_covariance
from ident.regression.options import SIGNIFICANT_RSD
from ident.result.units import parameter_unit
from ident.stored import Number, Real, Stored

LEAST_GAP = 2.0
"""Second-smallest over smallest singular value below which the null vector is poorly determined."""

SINGLE_JOINT_SHARE = 0.5
"""Share of the time with one joint alone in motion above which the runs do not suit this method."""

SMALL_ANGLE = 5.0
"""A motor signal nearer than this [degrees] to its own joint's columns contains little information on its gain."""


class JointGain(Stored):
    """Gain of one joint's drive, identified and of the robot file."""

    joint: str
    gain: Real = Field(
        description="torque per signal, joint side, sign included [N·m/A or N·m/V]; null where it is not identifiable"
    )
    std: Real = Field(description="σ; null where the gain is not identifiable")
    file_gain: Number = Field(description="of the robot file; null where it names none")

    @computed_field(description="σ [%] of the gain")  # type: ignore[prop-decorator]
    @property
    def rsd_percent(self) -> float:
        """Standard deviation [%] of the gain."""
        return 100.0 * self.std / abs(self.gain) if np.isfinite(self.gain) and self.gain else float("inf")

    @property
    def has_a_sign(self) -> bool:
        """Return whether its 95 % interval is on one side of 0; false where it is not identifiable."""
        return abs(self.gain) > WITHIN_95_PERCENT * self.std

    @property
    def change(self) -> float | None:
        """Return how much the gain is above the robot file's [%]."""
        return 100.0 * (self.gain / self.file_gain - 1.0) if self.file_gain and np.isfinite(self.gain) else None


class GainEstimate(JointGain):
    """Gain of one joint's drive from exciting motions."""

    angle_degrees: Real = Field(
        description="between the motor signal and the span of the columns that act on this joint alone (its friction, "
        "its motor inertia, …); small where gain and inertia are barely distinguishable"
    )
    confused_with: str = Field(
        description="inertial parameter or other gain whose estimate is most correlated with this one's"
    )
    correlation: Real = Field(description="with it")
    noise: Real = Field(description="σ of the filtered motor signal about the model [A or V]")


class EstimatedValue(Stored):
    """One estimated parameter."""

    name: str
    unit: str
    value: Number
    std: Number


class GainsFigures(Stored):
    """What both identifications of gains give, as `gains.json` holds it."""

    kind: str
    robot: str
    runs: list[str] = Field(description="free, loaded")
    signal: str = Field(description='recorded motor signal: "current" or "voltage"')
    unit: str = Field(description="of the gains")
    known: KnownLoad
    gains: Sequence[JointGain] = Field(description="one per joint")
    load: list[EstimatedValue] = Field(description="estimated load parameters; null where the motions do not show one")
    gap: Number = Field(
        description="second-smallest over smallest singular value; the null vector is sure where it is large"
    )
    robot_file_text: str
    warnings: list[str]

    @property
    def values(self) -> FloatArray:
        """(n,) gains."""
        return np.array([gain.gain for gain in self.gains])

    @property
    def std(self) -> FloatArray:
        """(n,) their standard deviations."""
        return np.array([gain.std for gain in self.gains])


class DriveGains(GainsFigures):
    """Gains of all drives from exciting motions."""

    kind: Literal["gains"] = "gains"
    gains: list[GainEstimate]
    covariance: list[list[Number]] = Field(description="(n, n) of the gains")
    base_parameters: list[EstimatedValue] = Field(
        description="the gains' uncertainty in their deviations; null where they were not estimated"
    )
    condition: Number = Field(
        description="largest over second-smallest singular value of what the model's columns leave of the signals"
    )
    delay: DelaySearch
    blocks: int = Field(description="of the jackknife")
    block_length: int = Field(description="samples per block")


def identify_gains(
    free: Recording,
    loaded: Recording,
    known: KnownLoad,
    robot_file: RobotFile | None = None,
    delay: float | None = None,
) -> DriveGains:
    """Gains of all drives.

    Args:
        free: recording without the load, with motor signals.
        loaded: recording of the same arm with it.
        known: of the load; its mass at least.
        robot_file: in place of the free recording's.
        delay: of the signals [s]; searched where None.

    Raises:
        DataError: different arms, no motor signal, or a known load that the motions do not show.
        IdentificationError: no gain is identifiable.
    """
    system, gains = gain_system(free, loaded, known, robot_file, delay)
    grams = system_blocks(system)
    covariance = jackknife_covariance(jackknife_moves(system, grams))
    drives = _gains(system, known, gains, covariance, grams)
    warnings = [*pair_warnings(system.pair, (free, loaded)), *_warnings(drives, system)]
    return drives.model_copy(update={"warnings": warnings})


def gain_system(
    free: Recording, loaded: Recording, known: KnownLoad, robot_file: RobotFile | None, delay: float | None
) -> tuple[GainSystem, FloatArray]:
    """The solved system of two runs, and the gains (n,) by which their torques were made."""
    robot_file = free.robot() if robot_file is None else robot_file
    robot = robot_file.robot
    # A first pass finds gains good enough to search the delay and the residuals' memory with.
    gains = np.array([robot.drive(name).gain or 1.0 for name in robot.joint_names])
    first = solve_gains(prepare_pair(free, loaded, torques_by(gains), robot_file, delay or 0.0), known)
    gains = gains * np.where(np.isfinite(first.relative_gains), first.relative_gains, 1.0)
    return solve_gains(prepare_pair(free, loaded, torques_by(gains), robot_file, delay), known), gains


def _gains(
    system: GainSystem, known: KnownLoad, gains: FloatArray, covariance: FloatArray, grams: BlockGrams
) -> DriveGains:
    pair, columns = system.pair, system.columns
    robot, count, dof = pair.robot_file.robot, pair.base.count, pair.model.dof
    used = list(system.used)
    scale = np.concatenate([gains[used], np.ones(len(system.layout) - 1)])
    # Joints whose gain is not identifiable have no finite variance.
    identifiable = [*used, *range(dof, dof + len(system.layout) - 1)]
    wide = np.diag(np.full(dof + len(system.layout) - 1, np.inf))
    wide[np.ix_(identifiable, identifiable)] = covariance * np.outer(scale, scale)
    covariance = wide
    deviations = np.sqrt(np.diag(covariance))
    values, spread = np.full(count + len(columns.names), np.nan), np.full(count + len(columns.names), np.nan)
    estimated = list(system.layout[:-1])
    values[estimated], spread[estimated] = system.solution.unknowns[:-1], deviations[dof:]
    names = [f"the gain of {name}" for name in robot.joint_names]
    names += [(*pair.base.names, *columns.names)[i] for i in estimated]
    # Friction is seen in the motor signal itself, so that it is correlated with the gain in any case.
    inertial = [
        dof + place
        for place, column in enumerate(estimated)
        if column >= count or pair.base.kinds[column] in ("inertial", "motor_inertia")
    ]
    others = [*used, *inertial]
    correlation = np.eye(len(deviations))
    within = np.ix_(identifiable, identifiable)
    correlation[within] = covariance[within] / np.outer(deviations[identifiable], deviations[identifiable])
    angles = own_angles(system)
    identified = gains * system.relative_gains
    signal = signal_of(robot)
    estimates = [
        GainEstimate(
            joint=name,
            gain=float(identified[joint]),
            std=float(deviations[joint]),
            file_gain=robot.drive(name).gain,
            angle_degrees=float(angles[joint]),
            **_most_correlated(correlation[joint], joint, names, others),
            noise=float(system.noise[joint] / abs(gains[joint])),
        )
        for joint, name in enumerate(robot.joint_names)
    ]
    units = [parameter_unit(pair.model, column) for column in pair.base.columns]
    return DriveGains(
        robot=robot.name,
        runs=[run.label for run in pair.runs],
        signal=signal,
        unit=gain_unit(signal, robot),
        known=known,
        gains=estimates,
        covariance=covariance[:dof, :dof].tolist(),
        base_parameters=estimated_values(pair.base.names, units, values[:count], spread[:count]),
        load=estimated_values(columns.names, columns.units, values[count:], spread[count:]),
        condition=system.solution.condition,
        gap=system.solution.gap,
        delay=pair.delay,
        blocks=grams.count,
        block_length=grams.length,
        robot_file_text=drives_text(robot, signal, estimates),
        warnings=[],
    )


def _most_correlated(correlation: FloatArray, joint: int, names: Sequence[str], among: Sequence[int]) -> dict[str, Any]:
    place = max((i for i in among if i != joint), key=lambda i: abs(float(correlation[i])))
    return {"confused_with": names[place], "correlation": float(correlation[place])}


def _alone_share(pair: RunPair) -> float:
    """Share of the samples with motion in which one joint moves and the others rest."""
    alone, samples = 0, 0
    for run in pair.runs:
        for segment in run.prepared.segments:
            moving = np.abs(segment.velocity[:, segment.used]) >= run.prepared.rest_velocity
            alone += int((moving.sum(axis=0) == 1).sum())
            samples += moving.shape[1]
    return alone / samples


def left_out_gains(gains: Sequence[JointGain]) -> list[str]:
    """Warnings of identified gains that the robot file's section leaves out."""
    return [
        f"the gain of {gain.joint} may be 0 or of either sign: the section for the robot file leaves it out"
        for gain in gains
        if np.isfinite(gain.gain) and not gain.has_a_sign
    ]


def _warnings(drives: DriveGains, system: GainSystem) -> list[str]:
    warnings, base = [], system.pair.base
    if _alone_share(system.pair) > SINGLE_JOINT_SHARE:
        warnings.append("mostly one joint moves alone, and static friction holds the others: try --up-and-down")
    for gain in drives.gains:
        if not np.isfinite(gain.gain):
            warnings.append(
                f"the gain of {gain.joint} is not distinguishable from its own friction and inertia (angle "
                f"{gain.angle_degrees:.1f}°): it gets no value, and its equations are left out; place the load off its "
                "axis"
            )
        elif gain.rsd_percent >= SIGNIFICANT_RSD:
            warnings.append(
                f"the gain of {gain.joint} is confounded with {gain.confused_with} (correlation "
                f"{gain.correlation:+.2f}): its relative standard deviation is "
                f"{percentage_text(gain.rsd_percent, 2)} %; move the joints around it more, or place the load off "
                "its axis"
            )
        elif gain.angle_degrees < SMALL_ANGLE:
            warnings.append(
                f"the motor signal of {gain.joint} is almost entirely its own friction and inertia (angle "
                f"{gain.angle_degrees:.1f}°): its gain rests on weak coupling to other joints"
            )
        if gain.file_gain is not None and gain.gain * gain.file_gain < 0:
            warnings.append(f"the gain of {gain.joint} has the opposite sign of the robot file's")
    warnings += left_out_gains(drives.gains)
    if system.solution.gap < LEAST_GAP:
        warnings.append(
            f"the gains are poorly determined: singular values {system.solution.gap:.1f} times apart, another set of "
            "gains and inertias fits nearly as well; record a richer motion or a heavier load"
        )
    unexcited = [name for column, name in enumerate(base.names) if column not in system.layout]
    if unexcited:
        warnings.append(f"the motions do not excite {', '.join(unexcited)}: they get no value")
    return warnings


def estimated_values(
    names: Sequence[str], units: Sequence[str], values: FloatArray, deviations: FloatArray
) -> list[EstimatedValue]:
    """Parameters with their units and standard deviations."""
    rows = zip(names, units, values.tolist(), deviations.tolist(), strict=True)
    return [EstimatedValue(name=name, unit=unit, value=value, std=std) for name, unit, value, std in rows]


def gain_unit(signal: str, robot: Robot) -> str:
    """Unit of the gains of an arm's joints."""
    return common_unit("N·m/A" if signal == "current" else "N·m/V", robot.sliding)


def drives_text(robot: Robot, signal: str, gains: Sequence[JointGain]) -> str:
    """The robot file's section `drives` with the identified gains; that of the file where none is or it may be 0."""
    lines = ["drives:"]
    for gain in gains:
        drive = robot.drive(gain.joint)
        identified = gain.has_a_sign
        fields = {"joint": quoted(gain.joint)}
        for key, value in (
            ("gain", f"{gain.gain:.5g}" if identified else drive.gain),
            ("gain_std", f"{gain.std:.2g}" if identified else drive.gain_std),
        ):
            if value is not None:
                fields[key] = str(value)
        fields |= {"signal": signal, "inertia": str(drive.inertia).lower()}
        lines.append(f"  - {{{', '.join(f'{key}: {value}' for key, value in fields.items())}}}")
    return "\n".join(lines)
