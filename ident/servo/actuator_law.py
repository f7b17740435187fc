"""What simulators' joint drives hold of a servo model: a PD law with limits and plain friction, and its roll-out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from drivers.core.arrays import FloatArray
from ident.servo.arm_rollout import roll_out_arm, rollout_errors
from ident.servo.links import ServoLinks
from ident.servo.motion import ServoMotion, lanes_of, motion_load
from ident.servo.rollout import profile_goals
from ident.servo.terms import INDEX, TERMS

REPLAYED = 120.0
"""[s] of motion at most in a replay."""

FAITHFUL = 1.2
"""Ratio of a replay's error to that of the model's own roll-out up to which the file stands for the model."""

POSES = 200
"""Random poses over which a joint's mean load is taken."""

SUDDEN = 1e-3
"""[rad/s or m/s] Stribeck velocity that stands for a static friction which ends as soon as a joint moves."""

NO_LIMIT = TERMS[INDEX["torque_limit"]].absent


@dataclass(frozen=True, eq=False)
class ActuatorLaw:
    """Drives of all joints as simulators compute them; arrays (n,), SI units.

    The command acts `delay` seconds late:

        τ = clip(stiffness·(command − q) − damping·q̇, ±effort_limit) − viscous·q̇ − friction

    Attributes:
        stiffness: [N·m/rad].
        damping: within the limit [N·m·s/rad].
        viscous: friction, outside of the limit [N·m·s/rad].
        armature: [kg·m²].
        static: friction at rest [N·m].
        dynamic: friction of a moving joint [N·m].
        effort_limit: [N·m].
        delay: [s].
    """

    stiffness: FloatArray
    damping: FloatArray
    viscous: FloatArray
    armature: FloatArray
    static: FloatArray
    dynamic: FloatArray
    effort_limit: FloatArray
    delay: FloatArray


def actuator_law(values: FloatArray, links: ServoLinks, delay_step: float) -> ActuatorLaw:
    """The law nearest to a servo model.

    Friction that follows the load is taken at the mean load of random poses. Damping stands within the limit, unless
    the data showed a limit: back-EMF takes no part in it.

    Args:
        values: (n, terms) parameters.
        links: of the arm.
        delay_step: in which the format counts delays [s]; 0 where it knows any.
    """

    def of(name: str) -> FloatArray:
        return values[:, INDEX[name]].copy()

    limit, load = of("torque_limit"), mean_load(links)
    limited = limit < NO_LIMIT
    stated = np.array([joint.torque or np.inf for joint in links.model.limits])
    dynamic = of("coulomb") + of("load_friction") * load
    delay = np.maximum(of("delay"), 0.0)
    return ActuatorLaw(
        stiffness=of("stiffness"),
        damping=np.where(limited, 0.0, of("damping")),
        viscous=np.where(limited, of("damping"), 0.0),
        armature=of("armature"),
        static=dynamic + of("breakaway") + of("load_breakaway") * load,
        dynamic=dynamic,
        effort_limit=np.where(limited, limit, stated),
        delay=np.rint(delay / delay_step) * delay_step if delay_step > 0 else delay,
    )


def mean_load(links: ServoLinks) -> FloatArray:
    """(n,) mean size of gravity's torque over random poses within the limits [N·m or N]."""
    low, high = (np.array(ends) for ends in zip(*(joint.position for joint in links.model.limits), strict=True))
    poses = np.random.default_rng(0).uniform(low, high, (POSES, len(low)))
    return np.asarray(np.abs(links.gravity(poses.T)).mean(axis=1), dtype=np.float64)


def law_values(law: ActuatorLaw) -> FloatArray:
    """(n, terms) parameters of a servo model that moves as the law does.

    A limit that damping shares is as good as one that it does not, as long as the drive does not reach it.
    """
    values = np.tile([term.absent for term in TERMS], (len(law.stiffness), 1))
    for name, column in (
        ("stiffness", law.stiffness),
        ("damping", law.damping + law.viscous),
        ("armature", law.armature),
        ("coulomb", law.dynamic),
        ("breakaway", law.static - law.dynamic),
        ("torque_limit", np.minimum(law.effort_limit, NO_LIMIT)),
        ("delay", law.delay),
    ):
        values[:, INDEX[name]] = column
    values[:, INDEX["stribeck_velocity"]] = SUDDEN
    return values


@dataclass(frozen=True)
class ServoReplay:
    """A file rolled out on recorded commands; mean absolute errors over all joints [rad or m].

    Attributes:
        file: its format.
        program: that read and moved it.
        error: with the commands as recorded.
        shaped_error: with the commands as the servos' profiles and biases shape them.
        model_error: of the model's own roll-out of the same motions.
        seconds: of motion.
        left_out: what the format has no place for, in words.
    """

    file: str
    program: str
    error: float
    shaped_error: float
    model_error: float
    seconds: float
    left_out: tuple[str, ...]

    @property
    def faithful(self) -> bool:
        """Whether the file moves as the model does, on commands as recorded."""
        return self.error <= FAITHFUL * self.model_error

    def __str__(self) -> str:
        text = (
            f"{self.program} on {self.seconds:.0f} s of recorded commands: {1e3 * self.error:.3g} mrad, with commands "
            f"that the servos' profiles shaped {1e3 * self.shaped_error:.3g}; dynid {1e3 * self.model_error:.3g} mrad"
        )
        if self.faithful or not self.left_out:
            return text
        return f"{text}. {self.file} has no place for {', '.join(self.left_out)}"


WORDS = {
    "acceleration_limit": "the servos' profile",
    "load_friction": "friction that follows the load",
    "breakaway": "breakaway friction",
    "load_breakaway": "breakaway friction",
    "dead_band": "the dead band",
    "bias": "the bias of the position loop",
    "delay": "the delay",
    "zero": "the encoders' zeros",
}
"""Terms that some format has no place for."""


def left_out(values: FloatArray, names: Sequence[str]) -> tuple[str, ...]:
    """Those of the named terms that some joint has, in words."""
    absent = {term.name: term.absent for term in TERMS}
    return tuple(dict.fromkeys(WORDS[name] for name in names if np.any(values[:, INDEX[name]] != absent[name])))


def some_motions(motions: Sequence[ServoMotion]) -> list[ServoMotion]:
    """The first motions, until they last `REPLAYED` seconds."""
    chosen, seconds = [], 0.0
    for motion in motions:
        if seconds < REPLAYED:
            chosen.append(motion)
            seconds += float(motion.time[-1])
    return chosen


def replay_of(
    file: str,
    program: str,
    motions: Sequence[ServoMotion],
    paths: tuple[Sequence[FloatArray], Sequence[FloatArray], Sequence[FloatArray]],
    missing: tuple[str, ...],
) -> ServoReplay:
    """The errors of paths (N, n) of each motion: on raw commands, on shaped ones, and of the model itself."""
    weights = [motion.time[-1] for motion in motions]
    error, shaped, own = (
        float(np.average(rollout_errors(motions, rows).mean(axis=1), weights=weights)) for rows in paths
    )
    return ServoReplay(file, program, error, shaped, own, float(sum(weights)), missing)


def shaped_commands(links: ServoLinks, motion: ServoMotion, values: FloatArray) -> FloatArray:
    """Commands (history + K, n) as the servos' profiles and biases shape them, before their delay."""
    zero = np.zeros(len(values))
    lanes = lanes_of([motion], [motion_load(links, motion, motion.time, motion.position, zero)], None)
    goals = profile_goals(lanes, np.zeros(len(values)), values[:, INDEX["acceleration_limit"]])
    # A goal is that at the end of its step.
    return np.concatenate([motion.command[: motion.history + 1], goals])[: len(motion.command)]


def replay_law(
    file: str,
    law: ActuatorLaw,
    links: ServoLinks,
    values: FloatArray,
    motions: Sequence[ServoMotion],
    missing: Sequence[str],
) -> ServoReplay:
    """Roll a law that was read from a file out on recorded commands.

    Args:
        file: its format.
        law: as read.
        links: of the arm.
        values: (n, terms) of the model.
        motions: recorded.
        missing: terms that the format has no place for.
    """
    chosen = some_motions(motions)
    held = law_values(law)
    if "zero" not in missing:
        held[:, INDEX["zero"]] = values[:, INDEX["zero"]]
    bias = values[:, INDEX["bias"]]
    shaped = [replace(motion, command=shaped_commands(links, motion, values) - bias) for motion in chosen]
    paths = tuple(
        roll_out_arm(several, links, parameters)
        for several, parameters in ((chosen, held), (shaped, held), (chosen, values))
    )
    return replay_of(file, "the actuators' law", chosen, paths, left_out(values, missing))  # type: ignore[arg-type]
