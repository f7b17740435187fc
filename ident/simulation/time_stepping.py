"""Time stepping of an arm with dry friction: Moreau's midpoint rule.

From (q, v), with the step h and the torque τ of the step,

    q½ = q + h/2·v
    M(q½)·(v⁺ − v) = h·(τ − b(q½, v̄) − V·v̄ − Dᵀλ)        v̄ = (v + v⁺)/2
    q⁺ = q½ + h/2·v⁺

λ is the dry friction that belongs to the velocity v⁺ after the step, a set-valued force: at rest it takes any value up
to the limit (`dry_friction`). So a joint at rest stays there (to rounding) until the torque breaks it away. Nothing
creeps or chatters, there is no smoothing velocity to choose and no stiff slope to integrate, and reversals need no
event search. Presliding (λ = f·z, `ident.model.presliding`) is implicit too: z is Dahl's state at the end of the step
for the velocity v⁺, a law that grows with v⁺ and is Coulomb's for a short travel. Friction that depends on speed or
load (Stribeck, |q̇|^α, load) is that at the beginning of each step, first order in h. Without dry friction the rule is
symmetric in time and of second order: the energy error is bounded (∝ h²) and does not drift. A reversal or a stop is
placed within the step, first order in h. Viscous friction is implicit, and never unstable. (J. J. Moreau, Unilateral
contact and dry friction in finite freedom dynamics, 1988; V. Acary and B. Brogliato, Numerical methods for nonsmooth
dynamical systems, 2008, ch. 10.)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.errors import DataError, ModelError
from drivers.core.units import joint_unit
from ident.simulation.compiled_stepping import compiled_stepping
from ident.simulation.dry_friction import dry_friction
from ident.simulation.forward_arm import ForwardArm

DIVERGED = 1e4
"""[rad/s or m/s] A velocity beyond which a simulation has diverged."""

ALTERNATIONS = 4
"""Successive changes of a torque's sign, step by step, that mark a controller as unstable with this step."""

PRECISION = 1e-9
"""Change of the velocity [rad/s], relative where it is above 1, at which v̄ counts as found."""

FULL = 1e-9
"""Share of dry friction that counts as no further rise of Dahl's state."""

ROUNDS = 10
"""Evaluations of the bias per step at most."""

Drive = Callable[[float, FloatArray, FloatArray], FloatArray]
"""Joint torques (n,) [N·m] for the step that begins at a time [s] with these positions and velocities (n,)."""


def diverged(velocity: FloatArray) -> bool:
    """Return whether a velocity (n,) is beyond all bounds, or no number."""
    return not bool(np.all(np.abs(velocity) < DIVERGED))


def divergence(
    arm: ForwardArm, time: float, position: FloatArray, velocities: FloatArray, torques: FloatArray
) -> ModelError:
    """The error of a motion that has diverged.

    Args:
        arm: that was simulated.
        time: of the last velocity [s].
        position: (n,) before it.
        velocities: (N + 1, n) up to it, the last one beyond all bounds.
        torques: (N, n) of the steps.
    """
    inertia = arm.inertia(position)
    if not (np.isfinite(inertia).all() and np.isfinite(arm.bias(position, velocities[-2])).all()):
        return ModelError(
            f"the model gives no finite inertia or gravity at {time:.4g} s, whatever the torque",
            hint="check the lengths, masses and parameters of the result",
        )
    joint = int(np.argmax(np.where(np.isfinite(velocities[-1]), np.abs(velocities[-1]), np.inf)))
    name = arm.joint_names[joint]
    speed, torque, mass = (joint_unit(unit, sliding=arm.sliding[joint]) for unit in ("rad/s", "N·m", "kg·m²"))
    moved = 1.0 / float(np.linalg.inv(inertia)[joint, joint])
    return ModelError(
        f"the simulated motion diverges at {time:.4g} s: {name} passes {DIVERGED:g} {speed}, its inertia {moved:.2g} "
        f"{mass} there, the other joints free, its torque {torques[-1, joint]:.3g} {torque}",
        hint=_hint(arm, name, torques[-1 - ALTERNATIONS :, joint]),
    )


def _hint(arm: ForwardArm, name: str, torque: FloatArray) -> str:
    """Return what to do, from the last torques of the joint."""
    if name in arm.accelerated:
        return (
            "its viscous friction is negative and accelerates it: simulate the physically consistent model "
            '(parameters="consistent", the default)'
        )
    if len(torque) > ALTERNATIONS and np.all(torque[1:] * torque[:-1] < 0.0):
        return "the torque changes sign at every step: use a shorter step, or softer gains for so little inertia"
    return "give a smaller torque, softer controller gains or a shorter step"


@dataclass(frozen=True, eq=False)
class SteppedMotion:
    """A simulated motion, N samples of n joints."""

    time: FloatArray  # (N,) from the start [s]
    position: FloatArray  # (N, n) [rad or m]
    velocity: FloatArray  # (N, n) [rad/s or m/s]
    # (N, n) of the step that begins with the sample, of the last sample that of the step before [N·m or N]
    torque: FloatArray


def integrate(
    arm: ForwardArm, position: FloatArray, velocity: FloatArray, drive: Drive, duration: float, steps: int
) -> SteppedMotion:
    """The motion from a state (n,) over `duration` [s] in equal steps, torque constant over each.

    Raises:
        ModelError: the inertia matrix is not positive definite, a loop does not close, or the motion diverges; says
            when and why.
    """
    step = duration / steps
    count = len(position)
    time = np.linspace(0.0, duration, steps + 1)
    positions, velocities, torques = (np.empty((steps + 1, count)) for _ in range(3))
    positions[0], velocities[0] = position, velocity
    stepping = _Stepping(arm, step, (positions, velocities, torques))
    for index, now in enumerate(time[:-1].tolist()):
        torques[index] = drive(now, positions[index].copy(), velocities[index].copy())
        if stepping.compiled is not None:
            if stepping.compiled.done(index):
                continue
            stepping.compiled = None  # from here on as without it, which says what is wrong
        try:
            positions[index + 1], velocities[index + 1] = stepping.next(
                positions[index], velocities[index], torques[index]
            )
        except np.linalg.LinAlgError as error:
            raise ModelError(
                f"the inertia matrix is not positive definite at {now:.4g} s, which leaves accelerations undefined",
                hint='simulate the physically consistent model (parameters="consistent", the default)',
            ) from error
        except DataError as error:  # a loop
            raise ModelError(f"at {now:.4g} s {error.message}", where=error.where, hint=error.hint) from error
        if diverged(velocities[index + 1]):
            raise divergence(arm, now + step, positions[index], velocities[: index + 2], torques[: index + 1])
    torques[steps] = torques[steps - 1]
    return SteppedMotion(time, positions, velocities, torques)


class _Stepping:
    """Steps of one arm; remembers what the next step starts its iteration from.

    Attributes:
        compiled: the same along given arrays; None without a library.
    """

    def __init__(self, arm: ForwardArm, step: float, motion: tuple[FloatArray, FloatArray, FloatArray]) -> None:
        from scipy.linalg.lapack import dgesv, dpotrf  # half a second that a recording need not wait

        self._factor, self._solve = dpotrf, dgesv
        self._arm, self._step = arm, step
        self._identity = np.eye(arm.dof)
        self._dry = np.zeros(len(arm.dry))
        self._change = np.zeros(arm.dof)
        self._state = np.where(arm.travel > 0.0, np.sign(arm.directions @ motion[1][0]), 0.0)
        bounds = PRECISION, DIVERGED, ROUNDS
        memory = self._dry, self._change, self._state
        self.compiled = compiled_stepping(arm, step, motion, memory, bounds)

    def next(self, position: FloatArray, velocity: FloatArray, torque: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Position and velocity (n,) after a step."""
        arm, step = self._arm, self._step
        middle = position + 0.5 * step * velocity
        inertia = arm.inertia(middle)
        if self._factor(inertia)[1] != 0:
            raise np.linalg.LinAlgError("not positive definite")
        viscous, driving = arm.viscous_at(velocity + 0.5 * self._change)
        limits = arm.dry_at(middle, velocity)
        inverse = self._solve(inertia + 0.5 * step * viscous, self._identity)[2]
        free = inertia @ velocity + step * (torque - driving - 0.5 * (viscous @ velocity))
        sliding = limits > 0.0
        directions = arm.directions[sliding]
        to_velocity = inverse @ directions.T
        matrix = step * (directions @ to_velocity)
        dry, state = self._dry[sliding], self._state[sliding]
        travel, limit = arm.travel[sliding] / step, limits[sliding]
        after, moved = velocity + self._change, 0.0
        for _ in range(ROUNDS):
            guess = after
            after = inverse @ (free - step * arm.bias(middle, 0.5 * (velocity + guess)))
            if len(dry):
                yielding = _compliance(directions @ guess, travel, limit, state)
                held = directions @ after + yielding * limit * state
                dry = dry_friction(matrix + np.diag(yielding), held, limit, dry)
                after = after - step * (to_velocity @ dry)
            before, moved = moved, _largest(after - guess)
            # Rounds contract by equal shares, so what the next one would change is known without it.
            coming = moved * min(1.0, moved / before) if before else moved
            if coming <= PRECISION * max(1.0, _largest(after)):
                break
        self._dry[sliding] = dry
        self._state[sliding] = np.where(travel > 0.0, dry / limit, 0.0)
        self._change[:] = after - velocity
        return middle + 0.5 * step * after, after


def _compliance(rate: FloatArray, travel: FloatArray, limit: FloatArray, state: FloatArray) -> FloatArray:
    """Return u over λ − f·z (m,) of Dahl's model over a step at a velocity; 0 of a direction without a travel.

    Args:
        rate: u (m,) about that after the step: the rounds bring it there [rad/s or m/s].
        travel: (m,) δ over the step's duration [rad/s or m/s]; 0 without.
        limit: f (m,).
        state: z (m,) before the step.
    """
    gradual = travel > 0.0
    passed = np.abs(rate) / np.where(gradual, travel, np.inf)
    covered = np.where(passed > 0.0, -np.expm1(-passed) / np.where(passed > 0.0, passed, 1.0), 1.0)
    room = np.maximum(1.0 - state * np.sign(rate), FULL)
    return np.asarray(np.where(gradual, travel / (limit * covered * room), 0.0))


def _largest(values: FloatArray) -> float:
    """The largest magnitude; in plain numbers, quicker for so few."""
    return float(max(map(abs, values.tolist())))
