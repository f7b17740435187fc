"""Every check that there is: its severity, the purposes that it spoils, its meaning and its remedy (docs/checks.md)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

from ident.verdict.check import PURPOSES, Check, Purpose, Severity

Subject = Literal["mistake", "data", "model"]
"""`mistake`: recording or robot file say something wrong, which other checks may follow from. `data`: what was recorded
does not show all that is asked. `model`: what was found."""


@dataclass(frozen=True)
class CheckKind:
    """What all checks of one name have in common.

    Attributes:
        name: stable; part of result.json.
        subject: what it speaks of.
        severity: of every check of this name.
        purposes: that it spoils; none exactly where it is a note.
        meaning: what it says, as a clause.
        remedy: what to do, as a sentence.
    """

    name: str
    subject: Subject
    severity: Severity
    purposes: tuple[Purpose, ...]
    meaning: str
    remedy: str


def _note(name: str, subject: Subject, meaning: str, remedy: str) -> CheckKind:
    return CheckKind(name, subject, "note", (), meaning, remedy)


ALL = PURPOSES
PREDICTION: tuple[Purpose, ...] = ("torque_prediction", "collision_detection")
PARAMETERS: tuple[Purpose, ...] = ("simulation", "payload_estimation")
"""Purposes that take the parameters one by one: wrong values that cancel in the torque spoil these only."""

_RECORDING = (
    _note(
        "recording-not-closed",
        "data",
        "the recording was stopped before its end, or not closed properly",
        "Its end may be missing; `dynid recover` rescues what a crash left.",
    ),
    CheckKind(
        "hand-guided",
        "mistake",
        "serious",
        ALL,
        "a hand led the arm: its forces are in no torque",
        "Identify from a motion that dynid plays; a recording of leading by hand shows where the arm was.",
    ),
    _note("import-warning", "data", "the import assumed or repaired something", "Read the sentence and import again."),
    _note(
        "samples-lost",
        "mistake",
        "samples of a stream are missing",
        "Segments end at gaps, and nothing is filled in; see the bus budget and the computer's load.",
    ),
    _note(
        "repeated-stamps",
        "mistake",
        "time stamps do not increase",
        "Import with --repair, or see the clock of the source.",
    ),
    CheckKind(
        "jittering-stamps",
        "mistake",
        "warning",
        PREDICTION,
        "the time stamps jitter",
        "Use the stamps of the robot's controller, not those of the receiving computer.",
    ),
    CheckKind(
        "position-unit",
        "mistake",
        "serious",
        ALL,
        "positions are in degrees or millimetres",
        "Convert them to rad (or m), or import with --degrees; else correct the limits of the robot file.",
    ),
    CheckKind(
        "position-jump",
        "mistake",
        "serious",
        ALL,
        "a position jumps between two samples",
        "The encoder lost counts or its zero: identify from the part before or after it, or record again.",
    ),
    CheckKind(
        "motion-as-torque",
        "mistake",
        "serious",
        ALL,
        "the torque is the position or the velocity",
        "Another column was taken for the torque or current: --column torque=NAME.",
    ),
    CheckKind(
        "steady-torque",
        "mistake",
        "serious",
        ALL,
        "no torque changes with the motion",
        "Another column, as a temperature, was taken for the torque or current: --column torque=NAME.",
    ),
    CheckKind(
        "same-column",
        "mistake",
        "serious",
        ALL,
        "two joints have one and the same torque",
        "One column was taken for both: see the columns' names.",
    ),
    CheckKind(
        "position-velocity-exchanged",
        "mistake",
        "serious",
        ALL,
        "position and velocity are exchanged",
        "See the columns' names: --column position=NAME --column velocity=NAME.",
    ),
    _note(
        "rows-missing",
        "mistake",
        "positions jump while the stamps go on: rows are missing or stand twice",
        "Segments end there, and nothing is filled in; write the source's own stamps.",
    ),
    _note(
        "position-wraps",
        "mistake",
        "angles are wrapped at a whole turn",
        "Segments end there; write angles that go on.",
    ),
    CheckKind(
        "wrong-time-axis",
        "mistake",
        "serious",
        ALL,
        "the time stamps are off by a constant factor",
        "Import again with the right --time-unit or --rate; the factor is in the sentence.",
    ),
    _note(
        "velocity-scale",
        "mistake",
        "the recorded velocity of some joints is not the change of their position",
        "It is not used unless --measured-velocity is given; check its unit and gear ratio.",
    ),
    CheckKind(
        "clocks-drift",
        "mistake",
        "warning",
        ALL,
        "two clocks drift apart",
        "Use one clock for all signals, or correct the stamps by the factor in the sentence.",
    ),
    CheckKind(
        "torque-ahead",
        "mistake",
        "warning",
        PARAMETERS,
        "the torque is ahead of its motion, which no drive can bring about",
        "Check the clocks of position and torque, a filter of the positions in the controller, and friction.",
    ),
    CheckKind(
        "unsigned-signal",
        "mistake",
        "serious",
        ALL,
        "a motor signal has lost its sign",
        "Record it with its sign; or identify a servo model from commands and encoder, --method servo.",
    ),
    CheckKind(
        "no-torque",
        "data",
        "serious",
        ("torque_prediction", "collision_detection", "payload_estimation"),
        "no torque or current is recorded with its sign",
        "Commands and encoder give a servo model: --method servo. Torques need a signed current or torque.",
    ),
    CheckKind(
        "positions-alone",
        "data",
        "serious",
        ALL,
        "neither torque nor commands are recorded",
        "Record torque or current with its sign, or the commanded positions: --column target_position=NAME.",
    ),
    CheckKind(
        "commands-short",
        "data",
        "warning",
        ("simulation",),
        "the commands do not cover the motion",
        "The rest of the motion has no known command: record both together.",
    ),
    CheckKind(
        "command-clock",
        "mistake",
        "serious",
        ("simulation",),
        "the stamps of commands and positions do not belong together",
        "Use one clock for both; a servo follows its command after some 0.05 to 0.2 s, and never before.",
    ),
    CheckKind(
        "command-order",
        "mistake",
        "serious",
        ("simulation",),
        "joints follow commands of other joints, or move against their own",
        "Match the columns again: --column, the robot file's aliases, or the order of its joints; check the signs.",
    ),
    CheckKind(
        "command-unit",
        "mistake",
        "serious",
        ("simulation",),
        "commands and positions differ by a constant factor",
        "State the unit of both in the file, or import with --degrees.",
    ),
    _note(
        "joint-at-rest",
        "data",
        "some joints are neither commanded to move nor do",
        "Nothing of them can be identified from commands and encoder; other motions may move them.",
    ),
    CheckKind(
        "signal-clipped",
        "mistake",
        "warning",
        ALL,
        "a motor signal is clipped",
        "Use a slower motion, or a wider range of the signal.",
    ),
    _note(
        "outliers-replaced",
        "data",
        "single samples are far from what their neighbours say, and are replaced by that",
        "Spikes and encoder glitches: see the encoder, its cable and the bus.",
    ),
    CheckKind(
        "many-outliers",
        "mistake",
        "warning",
        ALL,
        "too many samples are far from what their neighbours say to be replaced",
        "The fit uses them as they are: find what disturbs the signal and record again.",
    ),
    _note(
        "rows-repeated",
        "mistake",
        "rows or positions repeat those before them while the arm moves, and are left out",
        "Read the controller no faster than it measures, or import with --repair drop-repeats.",
    ),
    CheckKind(
        "encoder-stuck",
        "mistake",
        "warning",
        ALL,
        "an encoder stands still while its joint moves",
        "These samples are left out: check the encoder, its cable and the bus.",
    ),
    CheckKind(
        "filled-with-zeros",
        "mistake",
        "serious",
        ALL,
        "drop-outs of a signal were filled with zeros",
        "Leave these samples out, or write nan and import with --repair drop-nan.",
    ),
    _note(
        "positions-jitter",
        "mistake",
        "positions jitter, and the cut-offs that their spectrum would give were lowered",
        "Record the controller's own stamps and positions; --position-cutoff and --torque-cutoff set others.",
    ),
    CheckKind("no-motion", "data", "serious", ALL, "there is no motion to analyse", "Record an excitation trajectory."),
    _note(
        "high-condition",
        "data",
        "the condition number of the observation matrix is high",
        "Record a motion that `dynid excite` designed.",
    ),
    _note("slow-motion", "data", "joints use little of their velocity limit", "Record a faster motion."),
    CheckKind(
        "torque-beyond-limits",
        "mistake",
        "serious",
        ALL,
        "recorded torques are far beyond the joints' limits",
        "Check the unit of the current (A, not mA), the drive gains, and the torque limits of the robot file.",
    ),
    CheckKind(
        "torque-far-below-limits",
        "mistake",
        "serious",
        ALL,
        "recorded torques are orders below the joints' limits",
        "Check the unit of the current (A, not kA), the drive gains (joint side, gear ratio included), and the limits.",
    ),
    CheckKind(
        "implausible-load",
        "mistake",
        "serious",
        ALL,
        "recorded torques would hold a mass that no arm of this size has",
        "Check the unit of the current (A, not mA) and the drive gains.",
    ),
    CheckKind(
        "idle-joints",
        "data",
        "warning",
        PARAMETERS,
        "static friction of resting joints enters the fit",
        "Move all joints at once, or identify each run with --torques-of its moving joints and merge the models.",
    ),
)

_EXCITATION = (
    CheckKind(
        "residual-bursts",
        "mistake",
        "warning",
        PARAMETERS,
        "the residual has a few short bursts",
        "Something touched the arm, or a signal failed: leave these times out, or compare --method irls.",
    ),
    _note(
        "few-equations",
        "data",
        "there are few equations per parameter",
        "Record longer.",
    ),
    CheckKind(
        "weights-not-settled",
        "model",
        "warning",
        PARAMETERS,
        "weights do not settle",
        "Compare --method ols, or record longer: the values are those of the last iterate.",
    ),
    CheckKind(
        "search-gap",
        "model",
        "warning",
        ALL,
        "a search ended away from the optimum of its own cost",
        "Take --method wls, which is that optimum, or give the search more generations and a wider box.",
    ),
    _note(
        "few-independent-samples",
        "data",
        "there are few independent equations per parameter",
        "Record longer, and other motions rather than more of the same.",
    ),
    _note(
        "few-blocks",
        "data",
        "the error bars rest on few blocks",
        "Record longer: the standard deviations are themselves uncertain.",
    ),
    CheckKind(
        "unexcited-parameters",
        "data",
        "warning",
        PARAMETERS,
        "the motion does not excite some base parameters",
        "Record a motion that `dynid excite` designed.",
    ),
    _note(
        "insignificant-parameters",
        "data",
        "many base parameters are smaller than their standard deviation",
        "Record a more exciting motion.",
    ),
    CheckKind(
        "few-parameters-determined",
        "data",
        "warning",
        ALL,
        "the motion determines few of the base parameters",
        "Record a more exciting motion, or longer.",
    ),
    _note(
        "few-moves-for-energy",
        "data",
        "the energy model has one equation for all joints together",
        "Record many different moves rather than a periodic motion, or use --method wls.",
    ),
    CheckKind(
        "joints-locked",
        "data",
        "warning",
        ALL,
        "the model holds with some joints fixed where they were",
        "Move all joints, or name what is locked on purpose with --locked.",
    ),
    CheckKind(
        "resting-motor-torque",
        "data",
        "warning",
        PARAMETERS,
        "the torque of a motor at rest is used",
        "Leave it out with --torques-of: static friction or a brake may carry any share of it.",
    ),
)

_MODEL = (
    CheckKind(
        "negative-friction",
        "model",
        "warning",
        PARAMETERS,
        "friction came out negative (not dissipative)",
        "Check the sign of the drive gain; the model may lack a friction term.",
    ),
    _note(
        "negative-motor-inertia",
        "model",
        "a motor inertia of the unconstrained parameters came out negative",
        "Set `inertia: false` where torque sensors sit behind the gearbox, or use --no-motor-inertia.",
    ),
    CheckKind(
        "gravity-opposite",
        "mistake",
        "serious",
        ALL,
        "gravity of the opposite sign fits the data better",
        "Check `model.gravity`, how the arm is mounted, and the signs of the drive gains.",
    ),
    CheckKind(
        "gravity-direction",
        "mistake",
        "serious",
        ALL,
        "gravity in another direction fits the data better",
        "Check `model.gravity` and how the arm is mounted; the direction is in the sentence.",
    ),
    CheckKind(
        "torques-opposite",
        "mistake",
        "serious",
        ALL,
        "all torques have the opposite sign",
        "Change the sign of all drive gains, or import with --repair opposite-torque.",
    ),
    CheckKind(
        "positions-opposite",
        "mistake",
        "serious",
        ALL,
        "all positions have the opposite sign",
        "Change the sign of the position columns, or the axes of the robot file.",
    ),
    CheckKind(
        "torque-sign",
        "mistake",
        "serious",
        ALL,
        "a torque has the opposite sign",
        "Check the sign of this joint's drive gain.",
    ),
    CheckKind(
        "position-sign",
        "mistake",
        "serious",
        ALL,
        "a position has the opposite sign",
        "Check the sign of this joint's position column, and its axis in the robot file.",
    ),
    CheckKind(
        "joint-sign",
        "mistake",
        "serious",
        ALL,
        "position and torque of a joint have the opposite sign",
        "Check the direction of this joint's axis in the robot file.",
    ),
    CheckKind(
        "torques-exchanged",
        "mistake",
        "serious",
        ALL,
        "the torques of two joints are exchanged",
        "Check the order of the torque or current columns.",
    ),
    CheckKind(
        "positions-exchanged",
        "mistake",
        "serious",
        ALL,
        "the positions of two joints are exchanged",
        "Check the order of the position columns.",
    ),
    CheckKind(
        "joints-exchanged",
        "mistake",
        "serious",
        ALL,
        "positions and torques of two joints are exchanged",
        "Check the order of the columns, and of the joints in the robot file.",
    ),
    CheckKind(
        "motors-coupled",
        "mistake",
        "serious",
        ALL,
        "the recorded torques are those of coupled motors",
        "State it in the robot file (`model.coupling`), or record the joints' torques and positions.",
    ),
    CheckKind(
        "sign-or-column",
        "mistake",
        "serious",
        ALL,
        "a sign or a column of some joints is wrong",
        "The data do not tell which of those in the sentence: check their signs and the order of their columns.",
    ),
    CheckKind(
        "unsigned-torque",
        "mistake",
        "serious",
        ALL,
        "torques were recorded without their sign",
        "Record signed torques or currents; the sign that was lost cannot be restored.",
    ),
    CheckKind(
        "joint-zero",
        "mistake",
        "warning",
        ALL,
        "the torques agree better with another zero of a joint",
        "Check the zero of this joint's encoder against the robot file's.",
    ),
    CheckKind(
        "position-late",
        "mistake",
        "warning",
        ALL,
        "the position of a joint comes later than all else that was recorded",
        "Check how this joint's position is read and stamped: by another bus, filtered, or a cycle too late.",
    ),
    CheckKind(
        "wrong-gain",
        "mistake",
        "serious",
        ALL,
        "the torque of a joint is off by a factor",
        "Check its unit and its gain (gear ratio included); or identify the gains with a known load (`dynid gains`).",
    ),
    CheckKind(
        "other-size",
        "mistake",
        "serious",
        ALL,
        "the lengths of the robot file are those of an arm of another size",
        "Take the robot file or URDF of this arm, not that of a smaller or larger one of its family.",
    ),
    CheckKind(
        "inconsistent-gain",
        "mistake",
        "warning",
        ALL,
        "the drive gain of a joint does not agree with the other joints",
        "Identify the drive gains with a known load (`dynid gains`).",
    ),
    _note(
        "lengths-unchecked",
        "data",
        "the data do not show whether the lengths of the robot file are right",
        "Check that the file is this arm's; a faster motion of all joints would show it.",
    ),
    CheckKind(
        "inconsistent-length",
        "mistake",
        "warning",
        ALL,
        "the torques agree better with another length of the arm",
        "Check this length of the robot file or URDF, and that the file is this arm's.",
    ),
    CheckKind(
        "friction-near-reversals",
        "model",
        "warning",
        PARAMETERS,
        "the friction of the delivered model changes with more equations left out near velocity reversals",
        "Compare --reversals with the share in the sentence.",
    ),
    _note(
        "indefinite-inertia",
        "model",
        "the inertia matrix of the unconstrained parameters is not positive definite",
        "Simulate with the physically consistent parameters, which are the default.",
    ),
    CheckKind(
        "no-consistent-model",
        "model",
        "serious",
        PARAMETERS,
        "no physically consistent parameters were found",
        "Check the units of the recording, the geometry, and `known` and `prior` of the robot file.",
    ),
    CheckKind(
        "implausible-mass",
        "mistake",
        "serious",
        ALL,
        "the torques are those of a mass that no arm of this size, payload or URDF has",
        "Check the unit of torque or current, the drive gains, and the lengths of the robot file or URDF (m, not mm).",
    ),
    CheckKind(
        "implausible-link",
        "model",
        "warning",
        PARAMETERS,
        "a link is heavier than any of an arm of this size",
        "Check geometry, gains and signs; excite the link more, or state its mass under `prior`.",
    ),
    CheckKind(
        "implausible-centre",
        "model",
        "warning",
        PARAMETERS,
        "a link's centre of mass lies far from the link",
        "Check geometry, gains and signs; excite the link more, or state its centre under `prior`.",
    ),
    CheckKind(
        "known-contradicts-data",
        "model",
        "warning",
        PARAMETERS,
        "the data contradict what the robot file says of the links",
        "Correct `known` or `prior` of the robot file, or check gains and geometry.",
    ),
    _note(
        "weight-not-separate",
        "model",
        "no motion separates a joint's weight from its constant friction",
        "The torque is right, gravity alone as right as the masses: state them under `known` or `prior.links`.",
    ),
    _note(
        "consistency-rejected",
        "model",
        "no bodies explain the data as well as the unconstrained parameters do",
        "Large errors of the model make this, too; see how much the error rises, and geometry, gains and signs.",
    ),
    _note(
        "armature-assumed",
        "model",
        "motor inertia that the torque sensors do not see was assumed for simulation and MJCF",
        "State `drives[].armature` in the robot file.",
    ),
    CheckKind(
        "consistency-costs",
        "model",
        "warning",
        ALL,
        "the physically consistent model predicts held-out torque clearly worse than the unconstrained one, which "
        'load_model(…, parameters="full") gives',
        "The geometry, a drive gain or the signs of the torque may be wrong, or a friction column is missing.",
    ),
    CheckKind(
        "simulation-failed",
        "model",
        "serious",
        ("simulation",),
        "the physically consistent model could not be simulated along the held-out motion",
        "Read the reason; a prior for links at the boundary keeps their inertia away from zero.",
    ),
    _note(
        "links-on-boundary",
        "model",
        "links lie at the boundary of what can exist",
        "Their inertia comes from the condition rather than from the data: excite them more, or give a prior.",
    ),
    _note(
        "range-hit",
        "model",
        "a range of the robot file holds a parameter",
        "Widen the range if it was a guess.",
    ),
)

_RESIDUALS = (
    _note(
        "residuals-curved",
        "model",
        "the residuals bend with torque or velocity: the model lacks a nonlinear term",
        "Try --friction auto; see the friction in the report: Stribeck, or friction that grows less than velocity.",
    ),
    _note(
        "residuals-autocorrelated",
        "model",
        "the residuals are autocorrelated beyond the parallel filter: the model lacks something",
        "The error bars take it into account; look for what repeats with position, such as ripple of the gears.",
    ),
    _note(
        "residuals-uneven",
        "model",
        "the residuals grow with torque or velocity",
        "Parameters that show at low torque could be had more precisely than WLS weights them.",
    ),
    _note(
        "residuals-not-normal",
        "model",
        "the residuals have other tails than a normal distribution",
        "The 95 % intervals are approximate; outliers and velocity reversals make heavy tails.",
    ),
)

_VALIDATION = (
    _note(
        "errors-near-standstill",
        "model",
        "the validation's errors are larger than the identification's below 0.1 rad/s (or m/s) only",
        "Coulomb friction is not well defined near standstill: expect such errors at starts, stops and reversals.",
    ),
    CheckKind(
        "recording-changes",
        "mistake",
        "serious",
        ALL,
        "something changed while the arm was recorded",
        "A drive's gain, an encoder's zero, a load: identify from the part before or after it alone, or record again.",
    ),
    CheckKind(
        "recordings-differ",
        "mistake",
        "serious",
        ALL,
        "recordings of one identification show different bodies",
        "Another tool, load, gain or zero: identify each by itself, and compare the models with `dynid diff`.",
    ),
    CheckKind(
        "overfitting",
        "model",
        "warning",
        ALL,
        "the validation error is much larger than the identification's",
        "The model overfits, or the other motion shows effects that this one does not; record a richer motion.",
    ),
    CheckKind(
        "not-held-out",
        "data",
        "warning",
        ALL,
        "samples of the validation were used in the identification",
        "Validate with another recording; figures of data that were used say nothing of others.",
    ),
    CheckKind(
        "not-validated",
        "data",
        "warning",
        ALL,
        "nothing was held out to validate the model with",
        "Validate it with another recording (--validate).",
    ),
)

_MERGE = (
    CheckKind(
        "contradicting-models",
        "model",
        "warning",
        ALL,
        "the merged models contradict each other",
        "Another arm, load, temperature or drive gains, or error bars that are too small.",
    ),
    CheckKind(
        "partial-model",
        "model",
        "warning",
        ("simulation", "payload_estimation"),
        "the experiments show only some of the arm's base parameters",
        "Record an experiment with the other joints moving, and merge it, too.",
    ),
    _note("checks-of-a-part", "model", "a merged model has checks of its own", "Read them in its own result."),
)

_EXPORT = (
    CheckKind(
        "export-diverges",
        "model",
        "serious",
        ("simulation",),
        "the exported model diverges in simulation",
        "Excite the links named as lying on the boundary, or give a prior; smaller time steps help stiff friction.",
    ),
    CheckKind(
        "export-gains-energy",
        "model",
        "serious",
        ("simulation",),
        "the exported model gains energy without power",
        "Simulate with smaller time steps; light links with little friction turn too fast for these.",
    ),
    CheckKind(
        "export-loses-motion",
        "model",
        "serious",
        ("simulation",),
        "the exported model cannot follow a motion within its limits",
        "Compare the torque limits of the robot file with the torques of the recording.",
    ),
    CheckKind(
        "export-not-read",
        "model",
        "warning",
        ("simulation",),
        "MuJoCo did not read the exported file",
        "Install MuJoCo (pip install mujoco) and export again, or see what it does not accept.",
    ),
)

CATALOGUE: dict[str, CheckKind] = {
    kind.name: kind for kind in (*_RECORDING, *_EXCITATION, *_MODEL, *_RESIDUALS, *_VALIDATION, *_MERGE, *_EXPORT)
}
"""Every check by its name."""

MISTAKES = frozenset(kind.name for kind in CATALOGUE.values() if kind.subject == "mistake")
"""Checks that say what is wrong with a recording or a robot file."""


def raised(name: str, text: str, joints: Iterable[str] = ()) -> Check:
    """A check of the catalogue.

    Args:
        name: in the catalogue.
        text: what was seen, with its figures, and what to do.
        joints: names of those that it concerns.
    """
    kind = CATALOGUE[name]
    return Check(kind.name, kind.severity, kind.purposes, text, tuple(joints))
