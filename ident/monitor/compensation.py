"""The torques that carry an arm while it is led by hand, from an identified model; entered in `dynid.compensation`."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from daq.robot.loader import RobotFile
from drivers.core.arrays import FloatArray
from drivers.core.errors import UsageError
from ident.model.another_arm import another_arm
from ident.monitor.monitor import dry_friction
from ident.result.models.gravity_model import GravityModel
from ident.result.models.load_model import load_model

FRICTION_SHARE = 0.5
"""Share of the friction that is compensated: all of it would let the arm run on by itself."""
FADING = 0.1
"""[rad/s or m/s] below which that fades: at rest, dry friction keeps the arm from drifting."""


class WeightCompensation:
    """Weight, constant offsets, and half of the friction of a moving joint; a `daq.session.guiding.Compensation`.

    Args:
        robot_file: the arm.
        path: folder that `identify` wrote, or its result.json; with `--gravity`, too.

    Attributes:
        leaning: (n,) dry friction of the model [N·m or N].

    Raises:
        DynidError: the model cannot be read, or is of another arm.
        UsageError: the arm has joints that no motor moves alone.
    """

    def __init__(self, robot_file: RobotFile, path: Path) -> None:
        self._model = load_model(path)
        if said := another_arm(self._model.stored.robot_file, robot_file):
            raise UsageError(f"the robot file {said}", where=str(path), hint="give the model of this arm")
        if robot_file.robot.model.coupling or robot_file.robot.model.loops:
            raise UsageError("gravity compensation of coupled motors is not supported", where=robot_file.where)
        drives = [robot_file.robot.drive(name) for name in robot_file.robot.joint_names]
        self._gain = np.array([drive.gain or 1.0 if drive.signal == "torque" else 1.0 for drive in drives])
        self._rubs = not isinstance(self._model, GravityModel) and not self._model.dynamics.model.needs_temperature
        self.leaning: FloatArray = np.zeros(self._model.dof)
        if self._rubs:
            self.leaning = dry_friction(self._model) / np.abs(self._gain)

    def torque(self, position: FloatArray, velocity: FloatArray) -> FloatArray:
        """Torques (n,) as the drives count them [N·m or N], at a position and a velocity (n,) [rad or m, per s]."""
        held: FloatArray = self._model.torque(position) / self._gain
        if not self._rubs:
            return held
        rubbing = self._model.friction(velocity, position) - self._model.friction(np.zeros_like(velocity), position)
        helped: FloatArray = FRICTION_SHARE * np.minimum(np.abs(velocity) / FADING, 1.0) * rubbing / self._gain
        return held + helped
