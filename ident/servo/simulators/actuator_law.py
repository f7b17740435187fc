"""What simulators' joint drives hold of a servo model: a PD law with limits and plain friction, and its roll-out.

A file takes the values whose law moves nearest to the model on recorded commands: what the law has keeps the part of
what it lacks, as damping some of a profile's lag, and plain friction that of the load.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from drivers.core.arrays import FloatArray
from ident.servo.arm_rollout import roll_out_arm, rollout_errors
from ident.servo.contact import ServoContact
from ident.servo.links import ServoLinks
from ident.servo.motion import ServoMotion, known_load, lanes_of, measured_load
from ident.servo.rollout.goals import profile_goals
from ident.servo.search import EVERY_ERROR, evaluate, robust_scale, search
from ident.servo.terms import INDEX, TERMS, members, to_search

REPLAYED = 120.0
"""[s] of motion at most in a replay."""

FAITHFUL = 1.2
"""Ratio of a replay's error to that of the model's own roll-out up to which the file stands for the model."""

POSES = 200
"""Random poses over which a joint's mean load is taken."""

SUDDEN = 1e-3
"""[rad/s or m/s] Stribeck velocity that stands for a static friction which ends as soon as a joint moves."""

NEAR = 5e-4
"""[rad or m] Least scale of the errors that a nearest law is sought by."""

BY_LOAD = {"load_friction": "coulomb", "load_breakaway": "breakaway"}
"""Friction that follows the load, and what stands for it at the mean load."""

NO_LIMIT = TERMS[INDEX["torque_limit"]].absent


@dataclass(frozen=True, eq=False)
class ActuatorLaw:
    """Drives of all joints as simulators compute them; arrays (n,), SI units.

    The command acts `delay` seconds late:

        τ = clip(stiffness·(command − q) − damping·q̇, ±effort_limit) − viscous·q̇ − friction
    """

    stiffness: FloatArray  # [N·m/rad]
    damping: FloatArray  # within the limit [N·m·s/rad]
    viscous: FloatArray  # friction, outside of the limit [N·m·s/rad]
    armature: FloatArray  # [kg·m²]
    static: FloatArray  # friction at rest [N·m]
    dynamic: FloatArray  # friction of a moving joint [N·m]
    effort_limit: FloatArray  # [N·m]
    delay: FloatArray  # [s]


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
class FileFormat:
    """A simulator's file."""

    name: str  # in words
    program: str  # that moves it
    missing: tuple[str, ...]  # terms that it has no place for
    delay_step: float = 0.0  # in which it counts delays [s]; 0 where it knows any
    shaped: bool = False  # whether its commands are those that the servos' profiles and biases shaped


@dataclass(frozen=True)
class ServoReplay:
    """A file rolled out on recorded commands; mean absolute errors over all joints [rad or m]."""

    file: str  # its format
    program: str  # that read and moved it
    error: float  # of the file
    identified_error: float  # of one with the values as identified, not those nearest to the model
    model_error: float  # of the model's own roll-out of the same motions
    seconds: float  # of motion
    left_out: dict[str, float]  # what the format has no place for, in words: by how much it moves the model [rad or m]

    @property
    def faithful(self) -> bool:
        """Return whether the file moves as the model does."""
        return self.error <= FAITHFUL * self.model_error

    def __str__(self) -> str:
        text = (
            f"{self.program} on {self.seconds:.0f} s of recorded commands: {1e3 * self.error:.3g} mrad (values as "
            f"identified: {1e3 * self.identified_error:.3g}); dynid {1e3 * self.model_error:.3g} mrad"
        )
        if self.faithful:
            return text
        if not self.left_out:
            return f"{text}. {self.file} has every term: the rest is due to the time stepping of {self.program}"
        moved = ", ".join(f"{word} ({1e3 * error:.2g})" for word, error in self.left_out.items())
        return f"{text}. {self.file} cannot express what moves the model by so many mrad: {moved}"


WORDS = {
    "acceleration_limit": "the servos' profile",
    "load_friction": "friction that follows the load",
    "breakaway": "breakaway friction",
    "load_breakaway": "breakaway friction",
    "dead_band": "the dead band",
    "backlash": "the backlash",
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


def shaped_commands(motion: ServoMotion, values: FloatArray) -> FloatArray:
    """Commands (history + K, n) as the servos' profiles shape them, before their delay."""
    return profile_goals(motion.command, motion.step, values[:, INDEX["acceleration_limit"]])


def law_paths(
    law: ActuatorLaw, links: ServoLinks, zero: FloatArray, motions: Sequence[ServoMotion]
) -> list[FloatArray]:
    """Positions (N, n) of motions as a law rolls them out, with the encoders' zeros (n,)."""
    values = law_values(law)
    values[:, INDEX["zero"]] = zero
    return roll_out_arm(motions, links, values)


def nearest_file(
    form: FileFormat,
    values: FloatArray,
    links: ServoLinks,
    contact: ServoContact | None,
    motions: Sequence[ServoMotion],
    write: Callable[[FloatArray], str],
    play: Callable[[str, Sequence[ServoMotion]], Sequence[FloatArray]],
) -> tuple[str, ServoReplay | None]:
    """The text of a file whose roll-out is nearest to the model's, and its errors; without motions as identified.

    Args:
        form: of the file.
        values: (n, terms) of the model.
        links: of the arm.
        contact: what the arm touches, if the file has it.
        motions: recorded.
        write: the text of parameters (n, terms) that the format has.
        play: positions (N, n) of motions as a text moves.
    """
    plain = format_values(form, values, links)
    text, chosen = write(plain), some_motions(motions)
    if not chosen:
        return text, None
    model_paths = roll_out_arm(chosen, links, values, contact)
    commanded = chosen
    if form.shaped:
        bias = values[:, INDEX["bias"]]
        commanded = [replace(motion, command=shaped_commands(motion, values) - bias) for motion in chosen]
    words = left_out(values, form.missing)
    identified_error = error = _mean_error(commanded, play(text, commanded))
    if words:
        # a law is searched without what touches the arm
        free = model_paths if contact is None else roll_out_arm(chosen, links, values)
        played = [replace(motion, position=path) for motion, path in zip(commanded, free, strict=True)]
        nearest = write(nearest_values(form, plain, links, played))
        nearest_error = _mean_error(commanded, play(nearest, commanded))
        if nearest_error < error:
            text, error = nearest, nearest_error
    model_error = _mean_error(chosen, model_paths)
    seconds = float(sum(motion.time[-1] for motion in chosen))
    own = [replace(motion, position=path) for motion, path in zip(chosen, model_paths, strict=True)]
    lost = {}
    for word in words:
        lacking = _without(values, [name for name in form.missing if WORDS[name] == word], links)
        changed = roll_out_arm(chosen, links, lacking, contact)
        lost[word] = _mean_error(own, changed)
    return text, ServoReplay(form.name, form.program, error, identified_error, model_error, seconds, lost)


def _without(values: FloatArray, names: Sequence[str], links: ServoLinks) -> FloatArray:
    """Parameters (n, terms) without the named terms; friction at the mean load in place of what follows the load."""
    lacking = values.copy()
    for name in names:
        lacking[:, INDEX[name]] = TERMS[INDEX[name]].absent
        if name in BY_LOAD:
            lacking[:, INDEX[BY_LOAD[name]]] += values[:, INDEX[name]] * mean_load(links)
    return lacking


def format_values(form: FileFormat, values: FloatArray, links: ServoLinks) -> FloatArray:
    """Parameters (n, terms) without what a format lacks; friction that follows the load at the mean load."""
    plain = law_values(actuator_law(values, links, form.delay_step))
    for name in ("bias", "zero", "breakaway", "delay"):
        if name in form.missing or (form.shaped and name == "bias"):
            plain[:, INDEX[name]] = 0.0
        elif name in {"bias", "zero"}:
            plain[:, INDEX[name]] = values[:, INDEX[name]]
    return plain


def nearest_values(form: FileFormat, plain: FloatArray, links: ServoLinks, played: Sequence[ServoMotion]) -> FloatArray:
    """Parameters (n, terms) that a format has, whose roll-out is nearest to that of a model.

    Args:
        form: of the file.
        plain: (n, terms) the start.
        links: of the arm.
        played: motions whose positions are the model's roll-out.
    """
    loads = [known_load(measured_load(links, motion, plain[:, INDEX["zero"]]), motion) for motion in played]
    lanes = lanes_of(played, loads)
    fixed = [INDEX[name] for name in (*form.missing, *(("bias",) if form.shaped else ()))]
    free = np.zeros(plain.shape, dtype=np.bool_)
    free[:, members("")] = True
    free[:, fixed] = False
    free &= (plain > 0) | ~np.array([term.positive for term in TERMS])
    values, centre = plain, to_search(plain)
    for _ in range(2):
        scale = robust_scale(evaluate(lanes, values)[0], lanes, len(plain), NEAR)
        values = search(lanes, values, free, scale, centre, 12, EVERY_ERROR)
    return values


def _mean_error(motions: Sequence[ServoMotion], paths: Sequence[FloatArray]) -> float:
    """Over all joints, the first second of each motion left out."""
    weights = [motion.time[-1] for motion in motions]
    return float(np.average(rollout_errors(motions, paths).mean(axis=1), weights=weights))
