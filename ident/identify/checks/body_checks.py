"""Checks of the physically consistent bodies against the arm's size, its geometry and its URDF."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from daq.recording.repairs import OPPOSITE_TORQUE
from daq.robot.loader import RobotFile
from daq.robot.prior import PriorLink
from drivers.core.arrays import FloatArray
from drivers.core.errors import RobotFileError
from drivers.core.text import percent_text
from ident.assessment.arm_mass import PER_PAYLOAD, ArmMass, arm_length, end_shown, mass_of_size
from ident.assessment.validation import fit_errors
from ident.estimators.feasible.armature import ASSUMED
from ident.estimators.feasible.consistent import ConsistentParameters, found_consistent
from ident.identify.identification import Identification
from ident.model.base_parameters import BaseParameters
from ident.model.dynamic_model import DynamicModel
from ident.model.kinematics.urdf import UrdfBody, urdf_inertias
from ident.model.parameters import INERTIAL, MASS
from ident.regression.comparison import compare_torques
from ident.regression.estimate import Estimate
from ident.verdict.catalogue import MISTAKES, raised
from ident.verdict.check import Check

WRIST = 3.0
"""Factor below the lightest arm at which the apparent mass counts as wrong. It follows the joints that are measured
best, those of the wrist; one of a third of its usual mass brings simulated arms to 0.6 of the least."""

URDF_FACTOR = 5.0
"""Apparent mass over that of a URDF's bodies, or the reverse, beyond which one of them is wrong. Bodies of CAD models
lack cables, grease and motors, hardly more than half of the mass."""

URDF_AGREES = 1.5
"""Factor within which the data confirm a mass that the URDF states: what arms of this size weigh says nothing then. A
gripper's fingers or a pendulum may weigh more."""

BESIDE = 0.5
"""Distance of a link's centre of mass from the lines between its joints, over the arm's length, that no link has: 0.13
of a UR10's shoulder, 0.33 at most of the estimates of 40 random arms (studies/checks/plausible_bodies.py)."""

TOOL = 0.25
"""The same, added for the link that carries the tool."""

DENIED_FACTOR, DENIED_RISE = 2.0, 0.05
"""What the robot file says of links and joints is refused where it raises the torque error by this factor and so much;
less is a check."""

DENIED_MISFIT = 16.0
"""Rise of the sum of squares (four σ) beyond which the data deny that centres lie near their links."""

LEAST_SHARE = 0.005
"""Share of the arm's mass below which a link's centre of mass says nothing."""


def body_checks(
    model: DynamicModel,
    robot_file: RobotFile,
    base: BaseParameters,
    estimate: Estimate,
    consistent: ConsistentParameters,
    *,
    whole: bool,
) -> list[Check]:
    """Return what no arm of this size and geometry has, and what was assumed of its motors.

    Args:
        model: the arm.
        robot_file: its file, for the URDF's bodies.
        base: base parameters of the experiment.
        estimate: of them.
        consistent: what was found.
        whole: whether all joints moved and all torques were used; else they do not show the arm's mass. Frames that do
            not show how far the last links reach do not either.
    """
    links = _links(consistent)
    masses = links[:, MASS]
    apparent = consistent.apparent_mass if whole and end_shown(model) else None
    bodies = urdf_inertias(robot_file, model.link_names)
    checks = _total_checks(mass_of_size(model), _urdf_mass(bodies), robot_file.robot.payload, apparent)
    checks += _link_checks(model, masses, bodies)
    if far := _far_centres(model, masses, links[:, 6:9] / masses[:, None], bodies):
        boxed = found_consistent(model, base, estimate, _with_centres_near(model, robot_file, list(far)))
        # The data may leave open where they lie: masses that are not known make centres of known moments.
        if boxed is None or boxed.misfit > consistent.misfit + DENIED_MISFIT:
            checks.append(_centre_check(model, far))
    assumed = [armature for armature in consistent.armatures if armature.source == ASSUMED]
    if assumed:
        values = ", ".join(f"{body.joint} {body.value:.2g}" for body in assumed)
        text = (
            "the torque sensors do not see the motors' inertia, and simulation and MJCF assume one per joint "
            f"[kg·m²]: {values}; state it in the robot file (drives[].armature)"
        )
        checks.append(raised("armature-assumed", text, [body.joint for body in assumed]))
    return checks


def with_opposite_torques(identification: Identification, check: Check) -> Check:
    """The check of torques that all have the opposite sign, with what a refit to −τ gives.

    The parameters of −τ are the negative ones, so that only the consistent bodies are sought anew.
    """
    consistent, estimate = identification.consistent, identification.estimate
    opposite = found_consistent(
        identification.model, identification.base, replace(estimate, values=-estimate.values), identification.robot_file
    )
    if consistent is None or opposite is None:
        return check
    errors = consistent.fit.relative_error, _error(identification, -opposite.base)
    masses = [_kilograms(float(_links(bodies)[:, MASS].sum())) for bodies in (consistent.parameters, opposite)]
    text = (
        f"{check.text}; with −τ the torque error of the consistent model falls from {percent_text(errors[0], 2)} to "
        f"{percent_text(errors[1], 2)}, and its mass is {masses[1]} instead of {masses[0]}: import with --repair "
        f"{OPPOSITE_TORQUE}"
    )
    return replace(check, text=text)


def _error(identification: Identification, parameters: FloatArray) -> float:
    """Relative torque error of base parameters on the identification data."""
    model, columns = identification.model, identification.base.columns
    runs = [run.prepared for run in identification.runs]
    return fit_errors(
        [
            compared
            for run in runs
            for compared in compare_torques(model, columns, parameters, run.segments, run.parallel_filter)
        ]
    ).relative_error


def _links(consistent: ConsistentParameters) -> FloatArray:
    """(k, 10) standard parameters of the links."""
    return consistent.values[: len(INERTIAL) * len(consistent.sources)].reshape(-1, len(INERTIAL))


def refuse_denied(identification: Identification, checks: Sequence[Check]) -> None:
    """Refuse what a robot file says of links and joints where no data fit it, and nothing else is wrong.

    Raises:
        RobotFileError: names it, with what the data say.
    """
    consistent = identification.consistent
    if consistent is None or consistent.parameters.without is None:
        return
    # A mistake elsewhere makes a sound statement of the file look wrong.
    if any(c.severity == "serious" or (c.severity == "warning" and c.name in MISTAKES) for c in checks):
        return
    error = _error(identification, consistent.parameters.without)
    stated = consistent.fit.relative_error
    if stated > DENIED_FACTOR * error and stated - error > DENIED_RISE:
        raise RobotFileError(
            f"no data agree with {', '.join(consistent.parameters.contradicted)}: with it the torque error is "
            f"{percent_text(stated, 2)}, without it {percent_text(error, 2)}",
            where=identification.robot_file.where,
            hint="correct 'known' or 'prior.links', or the drive gains and the geometry",
        )


def _total_checks(
    size: ArmMass | None, urdf: float | None, payload: float | None, apparent: float | None
) -> list[Check]:
    """The mass that the torques show against what arms of this size, and with this payload, weigh, and the URDF."""
    if apparent is None:
        return []
    confirmed, (least, most) = urdf is not None and _agrees(apparent, urdf), PER_PAYLOAD
    sane = urdf is not None and (size is None or size.least <= urdf <= size.most)
    if size is not None and not confirmed and not size.least / WRIST <= apparent <= size.most:
        beside = (
            f"arms of this length weigh {_kilograms(size.least)} to {_kilograms(size.most)}: check the unit of torque "
            "or current, the gains, and the lengths of the robot file or URDF (m, not mm)"
        )
    elif payload is not None and not least / WRIST <= apparent / payload <= most:
        beside = (
            f"arms for a payload of {_kilograms(payload)} weigh {_kilograms(least * payload)} to "
            f"{_kilograms(most * payload)}: check the unit of torque or current, the gains, and 'payload' of the robot "
            "file"
        )
    elif sane and urdf is not None and not 1.0 / URDF_FACTOR <= apparent / urdf <= URDF_FACTOR:
        beside = (
            f"the URDF's links weigh {_kilograms(urdf)}: check the unit of torque or current and the gains, or the "
            "URDF's inertials"
        )
    else:
        return []
    return [raised("implausible-mass", f"the torques imply an arm of about {_kilograms(apparent)}; {beside}")]


def _agrees(mass: float, urdf: float) -> bool:
    return 1.0 / URDF_AGREES <= mass / urdf <= URDF_AGREES


def _link_checks(model: DynamicModel, masses: FloatArray, bodies: Sequence[UrdfBody | None]) -> list[Check]:
    """Links heavier than any of an arm of this size, and than the URDF's."""
    size = mass_of_size(model)
    if size is None:
        return []
    heavy = [
        link
        for link, (mass, body) in enumerate(zip(masses, bodies, strict=True))
        if mass > size.heaviest_link and (body is None or not _agrees(mass, body[0]))
    ]
    if not heavy:
        return []
    names = [model.link_names[link] for link in heavy]
    figures = ", ".join(f"{model.link_names[link]} {_kilograms(masses[link])}" for link in heavy)
    text = (
        f"links are too heavy for an arm of this length, {_kilograms(size.heaviest_link)} at most: {figures}; "
        "the data do not fit bodies of this arm: check geometry, gains and signs, or state masses under 'prior'"
    )
    return [raised("implausible-link", text, [name for name in names if name in model.joint_names])]


def _far_centres(
    model: DynamicModel, masses: FloatArray, centres: FloatArray, bodies: Sequence[UrdfBody | None]
) -> dict[int, float]:
    """Links whose centres of mass (k, 3) lie far from them and from the URDF's, and how far [m]."""
    far = {}
    for link, (mass, centre, body) in enumerate(zip(masses, centres, bodies, strict=True)):
        distance = min(_distance(centre, end) for end in _ends(model, link))
        if body is not None:
            distance = min(distance, float(np.linalg.norm(centre - body[1])))
        sliding = model.joints[link].prismatic or any(j.prismatic for j in model.joints if j.parent == link)
        if not sliding and mass > LEAST_SHARE * masses.sum() and distance > _allowed(model, link) > 0.0:
            far[link] = distance
    return far


def _ends(model: DynamicModel, link: int) -> list[FloatArray]:
    """Origins (3,) of the joints that a link carries; its own where there are none."""
    return [joint.translation for joint in model.joints if joint.parent == link] or [np.zeros(3)]


def _allowed(model: DynamicModel, link: int) -> float:
    """Distance [m] of a link's centre of mass from the lines between its joints that none exceeds."""
    return (BESIDE + (TOOL if link == model.tool_link else 0.0)) * arm_length(model)


def _with_centres_near(model: DynamicModel, robot_file: RobotFile, links: Sequence[int]) -> RobotFile:
    """The file with boxes that hold these links' centres of mass, where it states none."""
    robot = robot_file.robot
    stated = dict(robot.prior.links)
    for link in links:
        corners = np.vstack([np.zeros(3), *_ends(model, link)])
        low, high = corners.min(axis=0) - _allowed(model, link), corners.max(axis=0) + _allowed(model, link)
        said = stated.get(model.link_names[link], PriorLink())
        if said.com is None and said.com_box is None:
            stated[model.link_names[link]] = said.model_copy(update={"com_box": (tuple(low), tuple(high))})
    prior = robot.prior.model_copy(update={"links": stated})
    return robot_file.model_copy(update={"robot": robot.model_copy(update={"prior": prior})})


def _centre_check(model: DynamicModel, far: Mapping[int, float]) -> Check:
    """The check of centres of mass that the data place far from their links."""
    figures = ", ".join(f"{model.link_names[link]} {distance:.2g} m" for link, distance in far.items())
    text = (
        f"centres of mass lie far outside their links, in an arm {arm_length(model):.2g} m long: {figures}; the "
        "data do not fit bodies of this arm: check geometry, gains and signs, or state centres under 'prior' "
        "(com, com_box)"
    )
    names = [model.link_names[link] for link in far]
    return raised("implausible-centre", text, [name for name in names if name in model.joint_names])


def _distance(point: FloatArray, end: FloatArray) -> float:
    """Distance of a point (3,) from the line between the origin and `end` (3,) [m]."""
    square = float(end @ end)
    share = float(np.clip(point @ end / square, 0.0, 1.0)) if square > 0 else 0.0
    return float(np.linalg.norm(point - share * end))


def _urdf_mass(bodies: Sequence[UrdfBody | None]) -> float | None:
    """Mass [kg] of a URDF's bodies; None where a link has none, or all have the same, as placeholders do."""
    masses = [body[0] for body in bodies if body is not None]
    if len(masses) < len(bodies) or len(set(masses)) < 2:
        return None
    return float(sum(masses))


def _kilograms(mass: float) -> str:
    return f"{mass:,.0f} kg" if mass >= 10.0 else f"{mass:.2g} kg"
