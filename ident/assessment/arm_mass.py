"""What arms of a size weigh, from data sheets of 42 commercial arms: a scale for bodies that the data leave open.

A power law through mass m [kg] and reach r [m], least squares of log m on log r, gives m = 49·r^3.0 with a standard
deviation of a factor of 2.2; the arms lie between 0.17 (WidowX 250) and 4.0 (TX40) times it:

    UR3e 11.2/0.5 · UR5e 20.6/0.85 · UR10e 33.5/1.3 · UR16e 33.1/0.9 · UR20 64/1.75 · Franka FR3 17.8/0.855 · KUKA
    iiwa 7 23.9/0.8 · iiwa 14 29.9/0.82 · LWR 4 16/0.79 · KR 3 26.5/0.541 · KR 6 R900 52/0.901 · KR 10 R1100
    54/1.101 · KR 16 R1610 245/1.612 · KR 210 R2700 1077/2.696 · KR 500 R2830 2385/2.826 · Kinova Gen3 8.2/0.902 ·
    Stäubli TX40 27/0.515 · TX2-60 51.4/0.67 · TX2-90 114/1.0 · ABB IRB 120 25/0.58 · IRB 1200 54/0.9 · IRB 1600
    250/1.45 · IRB 2600 284/1.65 · IRB 4600 425/2.05 · IRB 6700 1280/2.65 · GoFa 5 28/0.95 · YuMi, one arm 9.5/0.559
    · Fanuc LR Mate 200iD 25/0.717 · M-10iD/12 145/1.441 · M-20iD/25 250/1.831 · R-2000iC/210F 1090/2.655 ·
    M-2000iA/1200 8600/3.734 · Doosan M1013 33/1.3 · Techman TM5-900 22.6/0.9 · AUBO i5 24/0.886 · xArm 6 12.2/0.7 ·
    Yaskawa GP7 34/0.927 · GP25 250/1.73 · GP180 970/2.702 · Meca500 4.5/0.33 · WidowX 250 2.3/0.65 · SO-101 0.9/0.4

(kg/m, manufacturers' data sheets, base included.) Over their nominal payload, mostly the type's number, they weigh 2.1
(Kinova Gen3 8.2/4, UR16e 33.1/16, iiwa 14 29.9/14) to 42 (IRB 1600-6 250/6): KR 500 4.8, UR5e 4.1, FR3 5.9, KR 6 8.7,
TX2-60 15, M-10iD 12, YuMi 19. The joints' frames of an arm are 1.4 reaches long, base to wrist.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ident.model.dynamic_model import DynamicModel
from ident.model.kinematics.joints import BASE_INDEX

DENSITY = 49.0
"""[kg/m³] mass of an arm over its reach cubed."""

LENGTHS_PER_REACH = 1.4
"""Length of an arm from frame to frame over its reach: 1.41 of the UR5e, 1.42 of the Panda, 1.50 of the TX40."""

LEAST_RATIO, MOST_RATIO = 0.1, 5.0
"""Mass over the law's that an arm can have: a little beyond the lightest and the heaviest of the table."""

WHOLE_ARM = 5
"""An arm of fewer moving joints may be a part of one, or a SCARA: its frames do not show how long its last link is."""

UNKNOWN_END = 6.0
"""Factor by which it may weigh more: the first three joints of a Motoman UP6 weigh 19 times the law's."""

LEAST_END = 0.05
"""Share of its length that a part of an arm must have between its last two joints: with none, as of three axes through
one point, the size of what is beyond them is anything, and the mass that the torques show is, too."""

PER_PAYLOAD = (2.0, 60.0)
"""Mass of an arm over its payload, a little beyond those of the table."""

LINK_SHARE = 0.6
"""Share of a whole arm's mass that one link has at most."""


@dataclass(frozen=True)
class ArmMass:
    """What an arm of a size weighs."""

    expected: float  # [kg]
    # least, most: [kg] of what can be taken for an arm
    least: float
    most: float

    @property
    def heaviest_link(self) -> float:
        """Mass [kg] that no link of such an arm has."""
        return LINK_SHARE * self.most


def mass_of_size(model: DynamicModel) -> ArmMass | None:
    """The mass of an arm of this length, at most with what slides drawn out; None where its frames have no length."""
    length, part = arm_length(model), part_of_arm(model)
    if not length > 0.0:
        return None
    return replace(mass_of_length(length, part), most=mass_of_length(length + travel(model), part).most)


def travel(model: DynamicModel) -> float:
    """Length [m] by which what slides is drawn out."""
    ranges = [limits.position for limits, slides in zip(model.limits, model.sliding, strict=True) if slides]
    return sum(high - low for low, high in ranges)


def mass_of_length(length: float, part: bool) -> ArmMass:
    """The mass of an arm, or of a part of one, of a length [m] from frame to frame."""
    expected = DENSITY * (length / LENGTHS_PER_REACH) ** 3
    return ArmMass(expected, LEAST_RATIO * expected, MOST_RATIO * expected * (UNKNOWN_END if part else 1.0))


def part_of_arm(model: DynamicModel) -> bool:
    """Return whether the joints' frames may show a part of the arm's length only."""
    return len(model.joints) < WHOLE_ARM or any(joint.prismatic for joint in model.joints)


def end_shown(model: DynamicModel) -> bool:
    """Whether the frames of an arm, or of a part of one, show how far its last links reach from the joints before."""
    lengths = [float(np.linalg.norm(joint.translation)) for joint in model.joints]
    inner = {joint.parent for joint in model.joints}
    last = max((lengths[n] for n in range(len(lengths)) if n not in inner), default=0.0)
    return not part_of_arm(model) or last > LEAST_END * arm_length(model)


def arm_length(model: DynamicModel) -> float:
    """Longest distance [m] from the base to a joint along the links, at position zero."""
    return max(joint_distances(model), default=0.0)


def joint_distances(model: DynamicModel) -> list[float]:
    """Distances [m] from the base to every joint along the links, at position zero."""
    lengths: list[float] = []
    for joint in model.joints:
        before = 0.0 if joint.parent == BASE_INDEX else lengths[joint.parent]
        lengths.append(before + float(np.linalg.norm(joint.translation)))
    return lengths
