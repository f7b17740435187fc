"""What reading an exported file again showed: its torques beside the model's, and simulations of 5 s."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.errors import ModelError
from drivers.core.text import percent_text
from ident.export.arm import ExportedArm
from ident.verdict.catalogue import raised
from ident.verdict.check import Check

STATES = 100
"""Random states at which torques are compared."""

TORQUE_TOLERANCE = 1e-6
"""Largest difference of a torque, over the largest torque, at which a file counts as the same model."""

DURATION = 5.0
"""[s] of a simulation."""

PERIOD = 2.5
"""[s] of the motion that is tracked, from rest to rest."""

SHARE = 0.25
"""Share of the position, velocity and acceleration limits that the tracked motion uses."""

BANDWIDTH = 30.0
"""[rad/s] of the controller that tracks it, critically damped."""

STUCK = 0.05
"""Share of the amplitude: how far a joint may stay behind until the controller overcomes its dry friction."""

LOST = 0.5
"""The motion counts as lost where a joint is farther from it than this share of its amplitude."""

ENERGY_GAIN = 0.05
"""Energy that an unpowered arm may gain, over the largest kinetic energy: rounding of the integration."""


@dataclass(frozen=True)
class Simulation:
    """5 s of an arm that was read from a file."""

    motion: str  # "unpowered": let go within its limits, offsets compensated; or "tracking"
    finite: bool  # whether it came to its end with finite positions and velocities
    # of the unpowered arm, the rise of its energy over the start, over the largest kinetic energy
    energy_gain: float | None = None
    # largest distance from the motion over its amplitude; None of the unpowered arm
    tracking_error: float | None = None

    @property
    def text(self) -> str:
        """A few words for it."""
        if not self.finite:
            return f"{self.motion}: diverges"
        if self.tracking_error is not None:
            return f"{self.motion}: finite, at most {percent_text(self.tracking_error, 2)} of the amplitude off"
        if not self.energy_gain:
            return f"{self.motion}: finite, energy never above its start"
        gained = percent_text(self.energy_gain, 2)
        return f"{self.motion}: finite, energy at most {gained} of its kinetic part above its start"


@dataclass(frozen=True)
class ReadBack:
    """A file read again by one reader."""

    reader: str  # name and version
    torque_error: float  # largest difference from the model's torque at `states` random states, over the largest torque
    states: int  # how many
    simulations: tuple[Simulation, ...] = ()  # of 5 s each
    remark: str = ""  # what the reader's model is, where it is not the whole arm

    @property
    def lines(self) -> list[str]:
        """Lines for the terminal."""
        remark = f" ({self.remark})" if self.remark else ""
        first = f"{self.reader}{remark}: torques within {self.torque_error:.1e} of the model's at {self.states} states"
        return [first, *(f"{DURATION:g} s {simulation.text}" for simulation in self.simulations)]


def check_same_torque(reading: ReadBack, where: str) -> None:
    """Refuse a file that is another model.

    Raises:
        ModelError: with the difference.
    """
    if not reading.torque_error <= TORQUE_TOLERANCE:
        raise ModelError(
            f"{reading.reader} reads a different model from the file: torques differ by {reading.torque_error:.2g} of "
            "the largest; it was not written",
            where=where,
        )


def simulation_checks(reading: ReadBack) -> list[Check]:
    """Checks of the simulations."""
    checks = []
    for simulation in reading.simulations:
        what = f"{simulation.motion} simulation of {DURATION:g} s in {reading.reader}"
        if not simulation.finite:
            checks.append(raised("export-diverges", f"The {what} diverges."))
        elif simulation.tracking_error is not None and simulation.tracking_error > LOST:
            text = f"The {what} loses its motion by {percent_text(simulation.tracking_error, 2)} of the amplitude."
            checks.append(raised("export-loses-motion", text))
        elif simulation.energy_gain is not None and simulation.energy_gain > ENERGY_GAIN:
            text = f"In the {what} the energy rises by {percent_text(simulation.energy_gain, 2)} of the kinetic energy."
            checks.append(raised("export-gains-energy", text))
    return checks


def random_states(arm: ExportedArm, count: int = STATES) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Positions, velocities and accelerations (a, count) within the limits; no joint at rest."""
    generator, limits = np.random.default_rng(0), arm.model.limits
    low, high = (np.array(limit)[:, None] for limit in zip(*(limit.position for limit in limits), strict=True))
    shape = (arm.model.dof, count)
    fast, strong = (
        np.array([getattr(limit, name) for limit in limits])[:, None] for name in ("velocity", "acceleration")
    )
    return (
        generator.uniform(low, high, shape),
        fast * generator.uniform(0.05, 1.0, shape) * generator.choice([-1.0, 1.0], shape),
        strong * generator.uniform(-1.0, 1.0, shape),
    )


def largest_share(difference: FloatArray, torque: FloatArray) -> float:
    """Largest difference over the largest torque."""
    return float(np.max(np.abs(difference)) / max(float(np.max(np.abs(torque))), 1e-300))


def tree_torque_error(arm: ExportedArm, tree: FloatArray, active: tuple[FloatArray, FloatArray, FloatArray]) -> float:
    """How far a URDF's torques are from the model's, what a URDF cannot hold added: motors, offsets, coupling, loops.

    The largest difference over the largest torque. The tree's torques (n, N) hold its friction; `active` are position,
    velocity and acceleration (a, N) of the joints with a motor.
    """
    _, velocity, acceleration = active
    follow = arm.model.tree_motion(*active).follow
    total = follow.T @ tree if follow.ndim == 2 else np.einsum("naN,nN->aN", follow, tree)
    total = total + arm.at_joints.inertia[:, None] * acceleration + arm.at_joints.offset[:, None]
    several = list(np.flatnonzero(arm.coupled))
    coupling, motors = arm.coupling[several], arm.motors
    turning = coupling @ velocity
    total += coupling.T @ (
        motors.inertia[several, None] * (coupling @ acceleration)
        + motors.viscous[several, None] * turning
        + motors.coulomb[several, None] * arm.model.coulomb_direction(turning)
        + motors.offset[several, None]
    )
    expected = arm.dynamics.torque(*active)
    return largest_share(total - expected, expected)


def tracked_motion(arm: ExportedArm, time: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A motion (a, N) there and back within the limits: home + A·(1 − cos ωt)/2, its velocity and acceleration."""
    rate = 2.0 * math.pi / PERIOD
    amplitudes = []
    for home, limits in zip(arm.home, arm.model.limits, strict=True):
        low, high = limits.position
        room = max(low - home, high - home, key=abs)
        within = min(abs(room), limits.velocity / (0.5 * rate), limits.acceleration / (0.5 * rate**2))
        amplitudes.append(math.copysign(SHARE * within, room))
    amplitude = np.array(amplitudes)[:, None]
    return (
        arm.home[:, None] + 0.5 * amplitude * (1.0 - np.cos(rate * time)),
        0.5 * amplitude * rate * np.sin(rate * time),
        0.5 * amplitude * rate**2 * np.cos(rate * time),
    )


def released(arm: ExportedArm) -> FloatArray:
    """(a,) where an unpowered arm is let go: away from the home position, which may be upright and in balance."""
    low, high = (np.array(limit) for limit in zip(*(limits.position for limits in arm.model.limits), strict=True))
    farther = np.where(high - arm.home >= arm.home - low, high, low)
    return np.asarray(arm.home + SHARE * (farther - arm.home))


def tracking_gains(inertia: FloatArray, coulomb: FloatArray, amplitude: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Stiffness and damping (n, n) of a controller: `BANDWIDTH` on the inertia, and stiff enough against dry friction.

    Args:
        inertia: (n, n) [kg·m²].
        coulomb: (n,) friction [N·m], which a light wrist has much of beside its inertia.
        amplitude: (n,) of the motion [rad or m].
    """
    against_friction = coulomb / (STUCK * np.maximum(amplitude, 1e-300))
    stiffness = BANDWIDTH**2 * inertia + np.diag(against_friction)
    damping = 2.0 * BANDWIDTH * inertia + np.diag(2.0 * np.sqrt(against_friction * inertia.diagonal().clip(0.0)))
    return stiffness, damping


def energy_gain(energy: FloatArray, kinetic: FloatArray) -> float:
    """Largest rise (N,) over the first value, over the largest kinetic energy; 0 of an arm that does not move."""
    largest = float(np.max(kinetic))
    return max(float(np.max(energy - energy[0])), 0.0) / largest if largest > 0.0 else 0.0


def tracking_error(position: FloatArray, wanted: FloatArray) -> float:
    """Largest distance (a, N) from a motion, each joint's over its amplitude."""
    return float(np.max(np.abs(position - wanted).max(axis=1) / np.ptp(wanted, axis=1)))
