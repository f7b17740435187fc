"""Every check that there is (docs/checks.md): those of recordings stand in `recording_kinds`, those of models here."""

from __future__ import annotations

from collections.abc import Iterable

from ident.verdict.check import ALL, PARAMETERS, PREDICTION, Check, CheckKind, note, wrong
from ident.verdict.recording_kinds import EXCITATION, RECORDING

_MODEL = (
    CheckKind(
        "negative-friction",
        "model",
        "warning",
        PARAMETERS,
        "the estimated friction is negative (not dissipative)",
        "Check the sign of the drive gain; the model may lack a friction term.",
    ),
    note(
        "negative-motor-inertia",
        "model",
        "an unconstrained motor inertia is negative",
        "Set `inertia: false` where torque sensors sit behind the gearbox, or use --no-motor-inertia.",
    ),
    wrong(
        "gravity-opposite",
        "the data fit gravity with the opposite sign better",
        "Check `model.gravity`, the mounting, and the signs of the drive gains.",
    ),
    wrong(
        "gravity-missing",
        "the torques hold no gravity",
        "Record the torques of the motors, not those beyond a compensation of gravity.",
    ),
    wrong(
        "gravity-direction",
        "the data fit another direction of gravity better",
        "Check `model.gravity` and the mounting; the message gives the direction.",
    ),
    wrong(
        "torques-opposite",
        "all torques have the opposite sign",
        "Reverse the sign of all drive gains, or import with --repair opposite-torque.",
    ),
    wrong(
        "positions-opposite",
        "all positions have the opposite sign",
        "Reverse the position columns, or the axes in the robot file.",
    ),
    wrong("torque-sign", "the torque of a joint has the opposite sign", "Check the sign of this joint's drive gain."),
    wrong(
        "position-sign",
        "the position of a joint has the opposite sign",
        "Check the sign of its position column and its axis in the robot file.",
    ),
    wrong(
        "joint-sign",
        "position and torque of a joint both have the opposite sign",
        "Check the direction of its axis in the robot file.",
    ),
    wrong(
        "torques-exchanged",
        "the torques of two joints are swapped",
        "Check the order of the torque or current columns.",
    ),
    wrong("positions-exchanged", "the positions of two joints are swapped", "Check the order of the position columns."),
    wrong(
        "joints-exchanged",
        "positions and torques of two joints are swapped",
        "Check the order of columns and of the robot file's joints.",
    ),
    wrong("position-scaled", "the position of a joint is off by a factor", "Check its gear ratio and encoder counts."),
    wrong("time-reversed", "the recording runs backwards in time", "Check the order of the rows and their stamps."),
    wrong(
        "torque-shifted",
        "torques belong to another time than the positions",
        "Check how torque and position are stamped and merged; shift the column by the time in the message.",
    ),
    wrong(
        "motors-coupled",
        "the recorded torques, positions or both are those of coupled motors",
        "For torques, state `model.coupling` in the robot file; convert positions to the joints' own.",
    ),
    wrong(
        "sign-or-column",
        "some joints have a wrong sign or column",
        "The data do not show which joint: check signs and column order of those named.",
    ),
    wrong(
        "unsigned-torque",
        "torques were recorded without their sign",
        "Record signed torques or currents; a lost sign cannot be restored.",
    ),
    CheckKind(
        "joint-zero",
        "mistake",
        "warning",
        ALL,
        "the torques fit another zero of a joint better",
        "Compare the encoder's zero with the robot file's.",
    ),
    CheckKind(
        "position-late",
        "mistake",
        "warning",
        ALL,
        "the position of a joint lags all other signals",
        "Check how it is read and stamped: another bus, a filter, a cycle too late.",
    ),
    CheckKind(
        "position-ripple",
        "mistake",
        "warning",
        ALL,
        "the position of a joint has an error that repeats with its angle",
        "Check the encoder's centring and correction table, or move more slowly.",
    ),
    wrong(
        "wrong-gain",
        "the torque of a joint is off by a factor",
        "Check its unit and gain (gear ratio included), or identify the gains with a known load (`dynid gains`).",
    ),
    wrong(
        "other-size",
        "the robot file has the lengths of an arm of another size, or all stamps are off by a factor",
        "Use the robot file or URDF of this arm; check the stamps' unit and rate.",
    ),
    CheckKind(
        "inconsistent-gain",
        "mistake",
        "warning",
        ALL,
        "the drive gain of a joint is inconsistent with the other joints",
        "Identify the drive gains with a known load (`dynid gains`).",
    ),
    note(
        "lengths-unchecked",
        "data",
        "the data do not verify the lengths in the robot file",
        "Check that the file belongs to this arm, or move all joints faster.",
    ),
    CheckKind(
        "inconsistent-length",
        "mistake",
        "warning",
        ALL,
        "the torques fit another length of the arm better",
        "Check this length, and that the file belongs to this arm.",
    ),
    CheckKind(
        "friction-near-reversals",
        "model",
        "warning",
        PARAMETERS,
        "the friction depends on how many equations near velocity reversals are left out",
        "Try --reversals with the share in the message.",
    ),
    note(
        "indefinite-inertia",
        "model",
        "the unconstrained inertia matrix is not positive definite",
        "Simulate with the physically consistent parameters (the default).",
    ),
    CheckKind(
        "no-consistent-model",
        "model",
        "serious",
        PARAMETERS,
        "no physically consistent parameters were found",
        "Check the units of the recording, the geometry, and `known` and `prior` of the robot file.",
    ),
    wrong(
        "implausible-mass",
        "the torques imply a mass that is impossible for an arm of this size, payload or URDF",
        "Check the unit of torque or current, the drive gains, and the lengths (m, not mm).",
    ),
    CheckKind(
        "torques-scaled",
        "mistake",
        "warning",
        ALL,
        "the torques are those of the URDF's bodies times one factor",
        "Check the unit of torque or current, all drive gains, and the URDF's masses.",
    ),
    note(
        "torque-biased",
        "mistake",
        "a large constant is added to the torque of a joint",
        "Check the zero of its torque sensor or current; the model's offset holds it. A spring does this, too.",
    ),
    CheckKind(
        "implausible-link",
        "model",
        "warning",
        PARAMETERS,
        "a link is too heavy for an arm of this size",
        "Check geometry, gains and signs; excite the link more, or state its mass under `prior`.",
    ),
    CheckKind(
        "implausible-centre",
        "model",
        "warning",
        PARAMETERS,
        "a centre of mass lies far outside its link",
        "Check geometry, gains and signs; excite the link more, or state its centre under `prior`.",
    ),
    CheckKind(
        "known-contradicts-data",
        "model",
        "warning",
        PARAMETERS,
        "the data contradict the robot file's statements about links",
        "Correct `known` or `prior` in the robot file, or check gains and geometry.",
        figures=True,
    ),
    CheckKind(
        "known-implausible",
        "model",
        "warning",
        PARAMETERS,
        "the robot file states a body or a joint that no arm of this size has",
        "Correct `known` or `prior` in the robot file; the message gives what is plausible.",
        figures=True,
    ),
    note(
        "weight-not-separate",
        "model",
        "a joint's weight and constant friction cannot be separated",
        "The sum is right; gravity alone is only as right as the masses: state them under `known` or `prior.links`.",
    ),
    note(
        "consistency-rejected",
        "model",
        "no bodies explain the data as well as the unconstrained parameters do",
        "Large model errors also cause this: check geometry, gains and signs.",
    ),
    note(
        "armature-assumed",
        "model",
        "a motor inertia that the torque sensors do not see was assumed for simulation and MJCF",
        "State `drives[].armature` in the robot file.",
    ),
    CheckKind(
        "consistency-costs",
        "model",
        "warning",
        ALL,
        "the physically consistent model predicts held-out torque clearly worse than the unconstrained one "
        '(load_model(…, parameters="full"))',
        "Check geometry, drive gains and torque signs; a friction term may be missing.",
    ),
    CheckKind(
        "simulation-failed",
        "model",
        "serious",
        ("simulation",),
        "the physically consistent model could not be simulated along the held-out motion",
        "See the reason; a prior keeps inertias away from zero.",
    ),
    note(
        "links-on-boundary",
        "model",
        "links lie on the boundary of physical consistency",
        "The constraint, not the data, sets their inertia: excite them more, or give a prior.",
    ),
    note("range-hit", "model", "a parameter is at a bound set in the robot file", "Widen the bound if it was a guess."),
)

_RESIDUALS = (
    CheckKind(
        "friction-changes",
        "model",
        "warning",
        PREDICTION,
        "the friction changes during the recording",
        "Record a warm arm, or its temperature over a range, and validate at another time.",
    ),
    note(
        "residuals-curved",
        "model",
        "the residuals are nonlinear in torque or velocity: the model lacks a term",
        "Try --friction auto, and look at the friction plots.",
    ),
    note(
        "residuals-autocorrelated",
        "model",
        "the residuals are autocorrelated beyond the parallel filter: the model lacks an effect",
        "The error bars allow for it; look for effects that repeat with position, such as gear ripple.",
    ),
    note(
        "residuals-uneven",
        "model",
        "the residuals grow with torque or velocity",
        "Parameters excited at low torque are less precise than they could be.",
    ),
    note(
        "residuals-not-normal",
        "model",
        "the residuals are not normally distributed",
        "The 95 % intervals are approximate; outliers and velocity reversals cause heavy tails.",
    ),
)

_VALIDATION = (
    note(
        "errors-near-standstill",
        "model",
        "the validation error is larger than the identification's only below 0.1 rad/s (or m/s)",
        "Expect errors at starts, stops and reversals.",
    ),
    wrong(
        "recording-changes",
        "the arm changed during the recording",
        "A drive gain, an encoder zero or a load changed: use the part before or after, or record again.",
    ),
    wrong(
        "recordings-differ",
        "the recordings show different bodies",
        "Tool, load, gain or zero differ: identify each separately, and compare with `dynid diff`.",
    ),
    CheckKind(
        "overfitting",
        "model",
        "warning",
        ALL,
        "the validation error is much larger than the identification's",
        "Record a richer motion, which shows the effects of the other one.",
    ),
    CheckKind(
        "not-held-out",
        "data",
        "warning",
        ALL,
        "the validation contains samples of the identification",
        "Validate with another recording.",
    ),
    CheckKind(
        "not-validated",
        "data",
        "warning",
        ALL,
        "the model was not validated on held-out data",
        "Give another recording with --validate.",
    ),
)

_MERGE = (
    CheckKind(
        "contradicting-models",
        "model",
        "warning",
        ALL,
        "the merged models contradict each other",
        "Arm, load, temperature or drive gains differ, or the error bars are too small.",
    ),
    CheckKind(
        "partial-model",
        "model",
        "warning",
        ("simulation", "payload_estimation"),
        "the experiments determine only some of the base parameters",
        "Merge an experiment in which the other joints move.",
    ),
    note("checks-of-a-part", "model", "a merged model has its own checks", "See its result."),
)

_EXPORT = (
    CheckKind(
        "export-diverges",
        "model",
        "serious",
        ("simulation",),
        "the exported model diverges in simulation",
        "Excite the links on the boundary or give a prior; stiff friction needs smaller time steps.",
    ),
    CheckKind(
        "export-gains-energy",
        "model",
        "serious",
        ("simulation",),
        "the exported model gains energy while unpowered",
        "Use smaller time steps: light links with little friction turn fast.",
    ),
    CheckKind(
        "export-loses-motion",
        "model",
        "serious",
        ("simulation",),
        "the exported model cannot follow a motion within its limits",
        "Compare the robot file's torque limits with the recorded torques.",
    ),
    CheckKind(
        "export-not-read",
        "model",
        "warning",
        ("simulation",),
        "MuJoCo could not read the exported file",
        "Install MuJoCo (pip install mujoco), or see what it rejects.",
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
