"""The C code of an exported model beside Pinocchio's recursive Newton-Euler algorithm in C++."""

from __future__ import annotations

import shutil
import statistics
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.agreement import check
from daq.robot.loader import load_robot
from ident.export.c_code.names import identifier
from ident.export.c_code.write import write_c
from ident.model.base_parameters import base_parameters, random_states
from ident.model.dynamic_model import DynamicModel, build_model
from ident.model.dynamics.inverse_dynamics import InverseDynamics
from ident.model.dynamics.pinocchio_model import pinocchio_model
from ident.model.true_parameters import truth_vector

COMPARED = """\
c_torque_ARM_ns: the exported C function `torque`, friction and motor inertia included, of the simulated arms with their
  true parameters; pinocchio_cpp_rnea_ARM_ns: pinocchio::rnea of the links alone, both compiled with -O2 and called for
  the same states from a loop in C or C++, CPU time; c_vs_pinocchio_cpp_ARM: the second over the first."""

NATIVE = Path(__file__).with_name("native")
STATES = 1000
PREFIX = Path(sysconfig.get_paths()["purelib"]) / "cmeel.prefix"
PINOCCHIO_OPTIONS = (
    "-std=c++17",
    "-DNDEBUG",
    "-DBOOST_MPL_LIMIT_LIST_SIZE=30",
    "-DBOOST_MPL_CFG_NO_PREPROCESSED_HEADERS",
    "-DPINOCCHIO_ENABLE_TEMPLATE_INSTANTIATION",
    f"-I{PREFIX}/include",
    f"-I{PREFIX}/include/eigen3",
    f"-L{PREFIX}/lib",
    f"-Wl,-rpath,{PREFIX}/lib",
    "-lpinocchio_default",
)


def run(calls: int = 200_000, repeats: int = 7, robots: Sequence[str] = ("ur5e", "panda", "sr400")) -> dict[str, float]:
    """Nanoseconds per call; nothing where there is no compiler, no Eigen for the side of Pinocchio."""
    if shutil.which("cc") is None:
        print("c_code: no C compiler 'cc', left out", file=sys.stderr)
        return {}
    results: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for robot in robots:
            model = build_model(load_robot(robot))
            truth = truth_vector(load_robot(robot))
            states = random_states(model, STATES)
            np.stack(states).transpose(2, 0, 1).tofile(folder / "states")
            base = base_parameters(model)
            dynamics = InverseDynamics(model, base, base.projection @ truth)
            program = _c_program(dynamics, folder)
            command = [program, "states", STATES, calls // STATES]
            sides = {f"c_torque_{robot}_ns": (command, float(dynamics.torque(*states).sum()))}
            if model.transmission.direct and _has_eigen():
                command, expected = _pinocchio_program(model, truth, states, folder)
                sides[f"pinocchio_cpp_rnea_{robot}_ns"] = ([*command, calls // STATES], expected)
            figures: dict[str, list[float]] = {side: [] for side in sides}
            for _ in range(repeats):  # in turn, so that a slow moment hits both
                for side, (command, expected) in sides.items():
                    nanoseconds, total = map(float, _output(command, folder).split())
                    check(side, np.array([total]), np.array([expected]), 1e-9)
                    figures[side].append(nanoseconds)
            medians = {side: statistics.median(values) for side, values in figures.items()}
            results |= medians
            if len(medians) == 2:
                ours, peer = medians.values()
                results[f"c_vs_pinocchio_cpp_{robot}"] = peer / ours
    return results


def _c_program(dynamics: InverseDynamics, folder: Path) -> str:
    prefix = identifier(dynamics.model.name)
    write_c(dynamics, folder / prefix, overwrite=True)
    definitions = (f'-DHEADER="{prefix}.h"', f"-DTORQUE={prefix}_torque", f"-DJOINTS={prefix.upper()}_JOINTS")
    source = str(NATIVE / "c_torque.c")
    _output(["cc", "-std=c99", "-O2", "-I.", *definitions, source, f"{prefix}.c", "-o", f"{prefix}.run", "-lm"], folder)
    return f"./{prefix}.run"


def _pinocchio_program(
    model: DynamicModel, truth: np.ndarray, states: tuple[np.ndarray, ...], folder: Path
) -> tuple[list[object], float]:
    """The command but for its last argument, and the sum of torques that it should print."""
    import pinocchio as pin

    reference = pinocchio_model(model, truth[: 10 * len(model.joints)])
    rows = []
    for index, joint in enumerate(model.joints):
        body = reference.inertias[index + 1]
        rows.append(
            np.concatenate(
                [[joint.parent + 1], joint.rotation.ravel(), joint.translation, [body.mass], body.lever]
                + [body.inertia.ravel()]
            )
        )
    np.array(rows).tofile(folder / "arm")
    program = folder / "pinocchio.run"
    if not program.exists():
        _output(["c++", "-O2", NATIVE / "pinocchio_rnea.cpp", "-o", program, *PINOCCHIO_OPTIONS], folder)
    data = reference.createData()
    torques = [pin.rnea(reference, data, *state) for state in zip(*(part.T for part in states), strict=True)]
    return ["./pinocchio.run", "arm", len(rows), "states", STATES], float(np.sum(torques))


def _has_eigen() -> bool:
    if shutil.which("c++") and (PREFIX / "include/eigen3").is_dir():
        return True
    print("c_code: no C++ compiler or no Eigen headers, Pinocchio's side left out", file=sys.stderr)
    return False


def _output(command: list[object], folder: Path) -> str:
    return subprocess.run(list(map(str, command)), cwd=folder, check=True, capture_output=True, text=True).stdout
