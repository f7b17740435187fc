"""Every check that there is (docs/checks.md): those of recordings stand in `recording_kinds`, those of models here."""

from __future__ import annotations

from collections.abc import Iterable

from ident.verdict.check import Check
from ident.verdict.check_kind import ALL, PARAMETERS, CheckKind, note
from ident.verdict.recording_kinds import EXCITATION, RECORDING

_MODEL = (
    CheckKind(
        "negative-friction",
        "model",
        "warning",
        PARAMETERS,
        "friction came out negative (not dissipative)",
        "Check the sign of the drive gain; the model may lack a friction term.",
    ),
    note(
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
    note(
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
    note(
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
    note(
        "weight-not-separate",
        "model",
        "no motion separates a joint's weight from its constant friction",
        "The torque is right, gravity alone as right as the masses: state them under `known` or `prior.links`.",
    ),
    note(
        "consistency-rejected",
        "model",
        "no bodies explain the data as well as the unconstrained parameters do",
        "Large errors of the model make this, too; see how much the error rises, and geometry, gains and signs.",
    ),
    note(
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
    note(
        "links-on-boundary",
        "model",
        "links lie at the boundary of what can exist",
        "Their inertia comes from the condition rather than from the data: excite them more, or give a prior.",
    ),
    note("range-hit", "model", "a range of the robot file holds a parameter", "Widen the range if it was a guess."),
)

_RESIDUALS = (
    note(
        "residuals-curved",
        "model",
        "the residuals bend with torque or velocity: the model lacks a nonlinear term",
        "Try --friction auto; see the friction in the report: Stribeck, or friction that grows less than velocity.",
    ),
    note(
        "residuals-autocorrelated",
        "model",
        "the residuals are autocorrelated beyond the parallel filter: the model lacks something",
        "The error bars take it into account; look for what repeats with position, such as ripple of the gears.",
    ),
    note(
        "residuals-uneven",
        "model",
        "the residuals grow with torque or velocity",
        "Parameters that show at low torque could be had more precisely than WLS weights them.",
    ),
    note(
        "residuals-not-normal",
        "model",
        "the residuals have other tails than a normal distribution",
        "The 95 % intervals are approximate; outliers and velocity reversals make heavy tails.",
    ),
)

_VALIDATION = (
    note(
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
    note("checks-of-a-part", "model", "a merged model has checks of its own", "Read them in its own result."),
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
    kind.name: kind for kind in (*RECORDING, *EXCITATION, *_MODEL, *_RESIDUALS, *_VALIDATION, *_MERGE, *_EXPORT)
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
