"""Prior knowledge for an excitation design: approximate base parameters and torque noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from daq.robot.loader import RobotFile
from daq.robot.schema import JointLimits, Robot
from drivers.core.arrays import FloatArray
from drivers.core.errors import ResultFileError, UsageError
from drivers.core.text import percent_text
from ident.model.base_parameters import BaseParameters, base_parameters
from ident.model.dynamic_model import build_model
from ident.model.true_parameters import truth_vector
from ident.result.models.model import result_path
from ident.result.result_file import read_result
from ident.result.schema import Result
from ident.signals.cutoffs import filtered_rate

ASSUMED_NOISE_SHARE = 0.01
"""Assumed torque noise of a joint, as a share of its torque limit."""

ASSUMED_NOISE = 1.0
"""The same [N·m or N] where the torque limit is unknown too."""


@dataclass(frozen=True)
class PriorKnowledge:
    """Knowledge before a recording."""

    parameters: FloatArray | None  # (b,) base parameters; None where nothing is known
    noise: FloatArray  # (n,) standard deviation of each joint's torque noise [N·m or N]
    source: str  # origin of both, in words
    # independent noise values per second [Hz]. Its density noise²/(rate/2) is what matters in the band in which the
    # model is fitted.
    rate: float


def recording_rate(robot: Robot) -> float:
    """The rate [Hz] at which an arm is recorded: of its first connection that states one, else of its truth."""
    for connection in robot.connections.values():
        rate = (connection.model_extra or {}).get("rate")
        if isinstance(rate, int | float) and not isinstance(rate, bool) and 0 < rate < float("inf"):
            return float(rate)
    return robot.truth.noise.rate


def find_prior(robot_file: RobotFile, result: str | Path | None = None) -> PriorKnowledge:
    """Prior of an arm: from an earlier identification, else from the file's truth, else assumed.

    Raises:
        ResultFileError: that file cannot be read or lacks what is needed.
        UsageError: it belongs to an arm with other base parameters.
        RobotFileError: the geometry cannot be used.
    """
    base = base_parameters(build_model(robot_file))
    if result is not None:
        path = result_path(result)
        return prior_of_result(read_result(path), robot_file.robot, base, where=str(path))
    robot = robot_file.robot
    assumed = np.array([assumed_noise(limits.torque) for limits in robot.joints])
    if not all(name in robot.truth.links for name in (*robot.joint_names, *robot.passive_names)):
        source = f"no parameters; torque noise of {_ASSUMPTION} assumed"
        return PriorKnowledge(None, assumed, source, recording_rate(robot))
    noise = np.array([robot.truth.noise.torque_std.get(name, 0.0) for name in robot.joint_names])
    source = "the robot file's truth"
    if not np.all(noise > 0):
        silent = [name for name, value in zip(robot.joint_names, noise, strict=True) if value <= 0]
        source += f"; it has no torque noise for {', '.join(silent)}: {_ASSUMPTION} assumed"
    truth = base.projection @ truth_vector(robot_file)
    return PriorKnowledge(truth, np.where(noise > 0, noise, assumed), source, robot.truth.noise.rate)


_ASSUMPTION = f"{percent_text(ASSUMED_NOISE_SHARE)} of the torque limit ({ASSUMED_NOISE:g} N·m where it is unknown)"


def assumed_noise(torque_limit: float | None) -> float:
    """Assumed torque noise [N·m or N] of a joint with this torque limit, None where unknown."""
    return ASSUMED_NOISE if torque_limit is None else ASSUMED_NOISE_SHARE * torque_limit


def least_noise(joints: Sequence[JointLimits]) -> FloatArray:
    """(n,) lower bound of the torque noise [N·m or N]: residuals of noise-free simulations are rounding residue."""
    return np.array([1e-6 * assumed_noise(limits.torque) for limits in joints])


def prior_of_result(result: Result, robot: Robot, base: BaseParameters, where: str) -> PriorKnowledge:
    """Parameters and noise of an identification.

    Its residuals are autocorrelated. They are scaled up by the ratio of corrected to classical standard deviations
    (median over the parameters): white noise of this size gives the same error bars.

    Raises:
        UsageError: its base parameters are not those of this arm.
        ResultFileError: a joint's residual or the rate of the filtered torques is missing.
    """
    stored = {parameter.name: parameter for parameter in result.base_parameters}
    expressions = {name: parameter.expression for name, parameter in stored.items()}
    if tuple(result.joints) != robot.joint_names or expressions != dict(zip(base.names, base.expressions, strict=True)):
        raise UsageError(
            f"was identified for '{result.robot}' with other base parameters than '{robot.name}' has",
            where=where,
            hint="identify this arm with the columns of its robot file, or omit --prior",
        )
    deviations = np.array([value for value in result.residuals.joint_std if value is not None and value >= 0])
    if len(deviations) != robot.dof:
        raise ResultFileError("lacks the residual of a joint", where=f"{where}: residuals.joint_std", hint=_AGAIN)
    ratios = [
        p.std / p.classical_std
        for p in result.base_parameters
        if p.std is not None and p.classical_std is not None and p.classical_std > 0
    ]
    noise = deviations * (float(np.median(ratios)) if ratios else 1.0)
    parameters = np.array([stored[name].value or 0.0 for name in base.names])
    return PriorKnowledge(
        parameters, np.maximum(noise, least_noise(robot.joints)), f"identified: {where}", _filtered_rate(result, where)
    )


_AGAIN = "identify again with this version of dynid"


def _filtered_rate(result: Result, where: str) -> float:
    """Rate [Hz] of the filtered torques that an identification compared."""
    from ident.identify.revalidate import stored_choices  # the room of identifications: only who has one pays for it

    used = [use for use in result.recordings if use.role == "identification"]
    rate = filtered_rate(stored_choices(result), used[0].rate_hz) if used and used[0].rate_hz > 0 else None
    if rate is None:
        raise ResultFileError("does not state the rate of its filtered torques", where=where, hint=_AGAIN)
    return rate
