"""Forward simulation at the public border: what a user gives is checked, what comes back is (N, n)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from drivers.core.arrays import FloatArray
from drivers.core.errors import DataError, ModelError, UsageError
from ident.model.dynamics.inverse_dynamics import InverseDynamics
from ident.result.arrays import samples
from ident.simulation.forward_arm import ForwardArm
from ident.simulation.time_stepping import Drive, SteppedMotion, integrate

DEFAULT_STEP = 1e-3
"""Step of a simulation [s]."""

MOST_STEPS = 5_000_000

Controller = Callable[[float, FloatArray, FloatArray], npt.ArrayLike]
"""Time [s], positions (n,) and velocities (n,) → joint torques (n,) [N·m], held for one step."""


@dataclass(frozen=True, eq=False)
class SimulatedMotion(SteppedMotion):
    """What `Model.simulate` gives: N samples, a step apart, of n joints."""

    joint_names: tuple[str, ...]  # (n,) of the arrays' columns


def simulated_motion(
    inverse: InverseDynamics,
    q0: npt.ArrayLike,
    dq0: npt.ArrayLike,
    torque: npt.ArrayLike | Controller | None,
    duration: float,
    step: float,
    kelvin: FloatArray | None = None,
) -> SimulatedMotion:
    """Simulate; arguments and errors as of `Model.simulate`, `kelvin` (n,) the joints' temperatures [K]."""
    names = inverse.model.joint_names
    start, single = samples(names, q0=q0, dq0=dq0)
    if not single:
        raise DataError(f"has {start[0].shape[1]} rows; one state ({len(names)},) is needed", where="q0")
    steps = _steps(duration, step)
    motion = integrate(
        ForwardArm(inverse, kelvin),
        start[0][:, 0],
        start[1][:, 0],
        _drive(names, torque, duration, steps),
        duration,
        steps,
    )
    return SimulatedMotion(**vars(motion), joint_names=names)


def _steps(duration: float, step: float) -> int:
    for name, seconds in (("duration", duration), ("step", step)):
        if not (math.isfinite(seconds) and seconds > 0):
            raise UsageError(f"{seconds:g} is not a positive number of seconds", where=name)
    if duration / step > MOST_STEPS:
        raise UsageError(
            f"{duration:g} s in steps of {step:g} s is more than {MOST_STEPS} steps",
            where="step",
            hint="use longer steps",
        )
    return max(1, round(duration / step))


def _drive(names: tuple[str, ...], torque: npt.ArrayLike | Controller | None, duration: float, steps: int) -> Drive:
    if torque is None:
        nothing = np.zeros(len(names))
        return lambda time, position, velocity: nothing
    if callable(torque):
        return _controlled(names, torque)
    (values,), single = samples(names, torque=torque)
    if single:
        constant = values[:, 0]
        return lambda time, position, velocity: constant
    if values.shape[1] < 2:
        raise DataError("has 1 row; give (n,) for a constant torque, or at least 2 rows", where="torque")
    grid = np.linspace(0.0, duration, values.shape[1])
    middle = (np.arange(steps) + 0.5) * (duration / steps)
    rows = np.array([np.interp(middle, grid, row) for row in values]).T
    return lambda time, position, velocity: rows[min(round(time / duration * steps), steps - 1)]


def _controlled(names: tuple[str, ...], controller: Controller) -> Drive:
    def drive(time: float, position: FloatArray, velocity: FloatArray) -> FloatArray:
        given = controller(time, position, velocity)
        try:
            values = np.asarray(given, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise DataError(f"the controller returned no numbers at {time:.4g} s", where="torque") from error
        if values.shape != (len(names),):
            raise DataError(
                f"the controller returned shape {values.shape} at {time:.4g} s; ({len(names)},) is needed",
                where="torque",
            )
        if not np.isfinite(values).all():
            joint = names[int(np.flatnonzero(~np.isfinite(values))[0])]
            raise ModelError(f"the controller's torque of {joint} is not finite at {time:.4g} s", where="torque")
        return values

    return drive
