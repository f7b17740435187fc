"""Record a robot arm, identify its dynamic model, use the model.

    run = dynid.Recording.from_dataframe("ur5e", frame)    # or from_arrays, from_dict, import_recording …
    result = dynid.identify(run, validation=other)          # the model with error bars, and how far to trust it
    print(result); result.plot(); result.save("model")
    model = dynid.load_model("model")
    model.torque(q, dq, ddq)                                # friction included; q alone: what holds the arm still

Robots         load_robot, builtin_robots, RobotFile, base_parameters
Recordings     Recording, read_recording, import_recording, write_recording, simulate, info
Motions        design_excitation, design_gravity_motion, design_servo_motion, load_trajectory
Identify       identify, identify_gravity, compare, merge, friction, payload, drive_gains
Results        load_result, load_model, Model, predict, monitor, validate, diff, History, Table
Errors         DynidError, and below it InputError and WorkError: each says what was wrong, where, and what to type

Arrays are (N, n): time first, joints last. Units are s, rad, rad/s, rad/s², A, N·m, kg, m. help(dynid.identify) shows
arguments, units, errors and an example; docs/python.md goes through the tasks. Names are imported when they are used.
"""

from __future__ import annotations

import os
import sys
from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from daq.importers.import_file import import_recording as import_recording
    from daq.recording.reader import read_recording as read_recording
    from daq.recording.recording import Recording as Recording
    from daq.recording.writer import write_recording as write_recording
    from daq.robot.loader import RobotFile as RobotFile
    from daq.robot.loader import builtin_robots as builtin_robots
    from daq.robot.loader import load_robot as load_robot
    from drivers.core.errors import DataError as DataError
    from drivers.core.errors import DiskError as DiskError
    from drivers.core.errors import DynidError as DynidError
    from drivers.core.errors import IdentificationError as IdentificationError
    from drivers.core.errors import ImportFileError as ImportFileError
    from drivers.core.errors import InputError as InputError
    from drivers.core.errors import ModelError as ModelError
    from drivers.core.errors import RecordingError as RecordingError
    from drivers.core.errors import ResultFileError as ResultFileError
    from drivers.core.errors import RobotFileError as RobotFileError
    from drivers.core.errors import UsageError as UsageError
    from drivers.core.errors import WorkError as WorkError
    from ident.fleet.fleet import Fleet as Fleet
    from ident.fleet.fleet import identify_fleet as identify_fleet
    from ident.result.models.gravity_model import GravityModel as GravityModel
    from ident.result.models.load_model import load_model as load_model
    from ident.result.models.model import Model as Model
    from ident.result.tables import Table as Table
    from ident.tasks.arguments import base_parameters as base_parameters
    from ident.tasks.comparison import MethodComparison as MethodComparison
    from ident.tasks.comparison import compare as compare
    from ident.tasks.difference import diff as diff
    from ident.tasks.excitation import ExcitationTrajectory as ExcitationTrajectory
    from ident.tasks.excitation import design_excitation as design_excitation
    from ident.tasks.excitation import design_gravity_motion as design_gravity_motion
    from ident.tasks.excitation import design_servo_motion as design_servo_motion
    from ident.tasks.excitation import load_trajectory as load_trajectory
    from ident.tasks.experiments import IdentifiedFriction as IdentifiedFriction
    from ident.tasks.experiments import IdentifiedGravity as IdentifiedGravity
    from ident.tasks.experiments import friction as friction
    from ident.tasks.experiments import identify_gravity as identify_gravity
    from ident.tasks.history import History as History
    from ident.tasks.identification import IdentificationResult as IdentificationResult
    from ident.tasks.identification import identify as identify
    from ident.tasks.identification import load_result as load_result
    from ident.tasks.loads import IdentifiedGains as IdentifiedGains
    from ident.tasks.loads import IdentifiedPayload as IdentifiedPayload
    from ident.tasks.loads import drive_gains as drive_gains
    from ident.tasks.loads import payload as payload
    from ident.tasks.monitoring import monitor as monitor
    from ident.tasks.prediction import Prediction as Prediction
    from ident.tasks.prediction import predict as predict
    from ident.tasks.recording_quality import RecordingQuality as RecordingQuality
    from ident.tasks.recording_quality import info as info
    from ident.tasks.servo import ServoModel as ServoModel
    from ident.tasks.servo import identify_servo as identify_servo
    from ident.tasks.servo import load_servo_model as load_servo_model
    from ident.tasks.validation import Validation as Validation
    from ident.tasks.validation import merge as merge
    from ident.tasks.validation import validate as validate
    from sim_drivers.synthetic.measurement import simulate as simulate
    from sim_drivers.synthetic.servo import simulate_servo as simulate_servo

_HOMES = {
    "daq.importers.import_file": ("import_recording",),
    "daq.recording.reader": ("read_recording",),
    "daq.recording.writer": ("write_recording",),
    "daq.robot.loader": ("RobotFile", "builtin_robots", "load_robot"),
    "daq.recording.recording": ("Recording",),
    "drivers.core.errors": (
        "DataError",
        "DiskError",
        "DynidError",
        "IdentificationError",
        "ImportFileError",
        "InputError",
        "ModelError",
        "RecordingError",
        "ResultFileError",
        "RobotFileError",
        "UsageError",
        "WorkError",
    ),
    "ident.result.models.gravity_model": ("GravityModel",),
    "ident.result.models.load_model": ("load_model",),
    "ident.result.models.model": ("Model",),
    "ident.result.tables": ("Table",),
    "ident.tasks.arguments": ("base_parameters",),
    "ident.tasks.comparison": ("MethodComparison", "compare"),
    "ident.tasks.difference": ("diff",),
    "ident.tasks.excitation": (
        "ExcitationTrajectory",
        "design_excitation",
        "design_gravity_motion",
        "design_servo_motion",
        "load_trajectory",
    ),
    "ident.tasks.experiments": ("IdentifiedFriction", "IdentifiedGravity", "friction", "identify_gravity"),
    "ident.tasks.history": ("History",),
    "ident.fleet.fleet": ("Fleet", "identify_fleet"),
    "ident.tasks.identification": ("IdentificationResult", "identify", "load_result"),
    "ident.tasks.loads": ("IdentifiedGains", "IdentifiedPayload", "drive_gains", "payload"),
    "ident.tasks.monitoring": ("monitor",),
    "ident.tasks.prediction": ("Prediction", "predict"),
    "ident.tasks.recording_quality": ("RecordingQuality", "info"),
    "ident.tasks.servo": ("ServoModel", "identify_servo", "load_servo_model"),
    "ident.tasks.validation": ("Validation", "merge", "validate"),
    "sim_drivers.synthetic.measurement": ("simulate",),
    "sim_drivers.synthetic.servo": ("simulate_servo",),
}
"""Module → its public names. Type checkers read the imports above, which a test holds against this table."""


def _refuse_hidden_packages() -> None:
    """Refuse to work with another package of the same name as one of ours, such as a folder beside the user's script.

    Raises:
        ImportError: names the package and the path that hides it.
    """
    home = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
    for name in ("drivers", "daq", "ident", "sim_drivers"):
        module = sys.modules.get(name)
        spec = find_spec(name) if module is None else module.__spec__
        place = None if spec is None else spec.origin
        if place is not None and os.path.dirname(os.path.dirname(os.path.abspath(place))) != home:
            raise ImportError(
                f"dynid's own package '{name}' is hidden by {os.path.abspath(place)}: rename it, "
                "or run your script from another one"
            )


_refuse_hidden_packages()

_MODULE_OF = {name: module for module, names in _HOMES.items() for name in names}

# There is no __all__: help(dynid) would print every class in full. dir(dynid) has the names.


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'dynid' has no attribute '{name}'")
    value = getattr(import_module(_MODULE_OF[name]), name)
    globals()[name] = value  # the next use does not come here
    return value


def __dir__() -> list[str]:
    return sorted(_MODULE_OF)
