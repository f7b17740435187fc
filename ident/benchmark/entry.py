"""What a method of the benchmark is given, and what it returns.

A method is a function of a `Training`. For torques it returns an object with `torque(q, dq, ddq)`, arrays (N, n) in and
out; it may also have `delay`, `bodies` and `parameters`. For servo arms it returns one with `roll_out(time, command,
start)`, and the function has the attribute `kind = "servo"`. `dynid.bench_methods` is the entry-point group of further
methods; on the command line, `module:function` names one.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import numpy as np

from daq.recording.recording import Recording
from daq.robot.loader import RobotFile
from drivers.core.arrays import FloatArray
from drivers.core.errors import UsageError
from drivers.core.text import did_you_mean
from ident.benchmark.dataset import Kind
from ident.benchmark.motion import BenchmarkMotion
from ident.model.parameters import INERTIAL

GROUP = "dynid.bench_methods"


@dataclass(frozen=True, eq=False)
class Training:
    """What a method learns from."""

    robot: RobotFile  # of the arm: joints, limits, kinematics, gravity; `robot.urdf_text` is its URDF where it has one
    recordings: tuple[Recording, ...]  # the training parts, raw
    motions: tuple[BenchmarkMotion, ...] = ()  # states and torques of the same parts; empty for servo arms


@dataclass(frozen=True, eq=False)
class TorquePredictor:
    """The torques of a model; a third party may return any object with these attributes, at least `torque`."""

    # (q, dq, ddq), each (N, n), to joint torques (N, n) [N·m or N]
    torque: Callable[[FloatArray, FloatArray, FloatArray], FloatArray]
    # of the recorded torques behind the positions, as the method estimates it: one, or (n,) [s]
    delay: float | FloatArray = 0.0
    # (links, 10) XX, XY, XZ, YY, YZ, ZZ, MX, MY, MZ, M of each link in its frame; None where it has none
    bodies: FloatArray | None = None
    # name → value and σ, to be compared between two parts of the data; empty where it has no intervals
    parameters: Mapping[str, tuple[float, float]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class ServoPredictor:
    """A servo model: (time (M,) [s], command (M, n), start (n,)) to positions (M, n) [rad or m]."""

    roll_out: Callable[[FloatArray, FloatArray, FloatArray], FloatArray]


Method = Callable[[Training], Any]

METHODS = {
    "dynid": "ident.benchmark.entries.dynid_model:delivered",
    "dynid-full": "ident.benchmark.entries.dynid_model:full",
    "dynid-ols": "ident.benchmark.entries.dynid_model:ols",
    "dynid-irls": "ident.benchmark.entries.dynid_model:irls",
    "pinocchio-lstsq": "ident.benchmark.entries.plain_regression:pinocchio_lstsq",
    "figaroh": "ident.benchmark.entries.figaroh_base:figaroh_base",
    "ridge": "ident.benchmark.entries.black_boxes:ridge",
    "nearest-neighbour": "ident.benchmark.entries.black_boxes:nearest_neighbour",
    "dynid-servo": "ident.benchmark.entries.servo_models:dynid_servo",
    "mujoco-sysid": "ident.benchmark.entries.mujoco_sysid:mujoco_sysid",
    "delay-and-lag": "ident.benchmark.entries.servo_models:delay_and_lag",
    "command": "ident.benchmark.entries.servo_models:command_itself",
}
"""Entries that come with dynid, as `module:function`."""

SERVO_METHODS = frozenset({"dynid-servo", "mujoco-sysid", "delay-and-lag", "command"})
"""Those of them that are for servo arms: no process is started to ask."""

DEFAULTS = ("dynid", "dynid-servo")
"""Entries whose losses are listed: what `dynid identify` does without options."""


def all_methods() -> dict[str, str]:
    """Every known method by name, those of installed packages included, as `module:function`."""
    return METHODS | {entry.name: entry.value for entry in entry_points(group=GROUP)}


def chosen_methods(names: tuple[str, ...]) -> dict[str, str]:
    """Methods by name, or as `module:function`; every known one where none is named.

    Raises:
        UsageError: there is no such method.
    """
    methods = all_methods()
    chosen = {}
    for name in names or tuple(methods):
        if name not in methods and ":" not in name:
            hint = did_you_mean(name, methods) or "your own function: module:function"
            raise UsageError(f"no method is called '{name}'; there are {', '.join(methods)}", hint=hint)
        chosen[name] = methods.get(name, name)
    return chosen


def load_method(place: str) -> Method:
    """The function at `module:function`; modules are looked for in the current folder, too.

    Raises:
        UsageError: there is no such function, or its module cannot be imported.
    """
    module, _, name = place.partition(":")
    here = str(Path.cwd())
    sys.path.append(here)
    try:
        function = getattr(import_module(module), name, None)
    except (ImportError, ValueError) as error:
        raise UsageError(f"the method's module cannot be imported: {error}", where=place) from error
    finally:
        sys.path.remove(here)
    if not callable(function):
        raise UsageError("there is no such function", where=place, hint="module:function")
    method: Method = function
    return method


def kind_of(method: Method) -> Kind:
    """Data sets that a method is for."""
    return getattr(method, "kind", "torque")


def torque_predictor(returned: Any, place: str) -> TorquePredictor:
    """Return what a method returned, with what it left out.

    Raises:
        UsageError: it has no function `torque`, or `bodies` of another shape.
    """
    torque = getattr(returned, "torque", None)
    if not callable(torque):
        raise UsageError("the method returned nothing that has a function torque(q, dq, ddq)", where=place)
    bodies = getattr(returned, "bodies", None)
    if bodies is not None:
        bodies = np.asarray(bodies, dtype=np.float64)
        if bodies.ndim != 2 or bodies.shape[1] != len(INERTIAL):
            raise UsageError(f"bodies {bodies.shape} are not (links, {len(INERTIAL)})", where=place)
    given = getattr(returned, "parameters", None) or {}
    return TorquePredictor(torque, np.asarray(getattr(returned, "delay", 0.0), dtype=np.float64), bodies, given)


def servo_predictor(returned: Any, place: str) -> ServoPredictor:
    """Return what a method for servo arms returned.

    Raises:
        UsageError: it has no function `roll_out`.
    """
    roll_out = getattr(returned, "roll_out", None)
    if not callable(roll_out):
        raise UsageError("the method returned nothing that has a function roll_out(time, command, start)", where=place)
    return ServoPredictor(roll_out)
