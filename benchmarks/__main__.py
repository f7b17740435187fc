"""`python -m benchmarks`: run everything, print a table, write results.json beside this file.

The exit status is 0 also where a goal is missed: this reports. A benchmark that fails ends the run with its traceback.
"""

from __future__ import annotations

import json
import operator
import os
import platform
import sys
import time
from importlib.metadata import version
from pathlib import Path

from benchmarks import startup
from benchmarks.identification import (
    accuracy,
    command,
    consistency,
    decimation,
    excitation,
    memory,
    methods,
    parameters,
    pipeline,
    regressor,
    swarm,
)
from benchmarks.models import c_code, model, plant, simulation
from benchmarks.recording import recorder
from ident.compiled.library import kernels

RESULTS = Path(__file__).with_name("results.json")

GOALS = {
    "regressor_vs_pin_loop": ("≥", 8.0),
    "regressor_vs_figaroh_builder": ("≥", 10.0),
    "parameters_vs_pin_lstsq_200k": ("≥", 4.0),
    "parameters_vs_figaroh_20k": ("≥", 15.0),
    "memory_growth_mb_2m": ("≤", 50.0),
    "error_vs_lstsq_cond_1e6": ("≤", 10.0),
    "decimation_vs_column_loop": ("≥", 5.0),
    "help_vs_import_numpy": ("≤", 3.0),
    "import_vs_import_numpy": ("≤", 1.0),
    "identify_vs_imports": ("≤", 2.0),
    "consistency_panda_ms": ("≤", 50.0),
    "consistency_vs_clarabel_on_rows": ("≥", 100.0),
    "simulate_vs_mj_step_loop_ur5e": ("≥", 1.0),
    "simulate_vs_mj_step_loop_sr400": ("≥", 1.0),
    "simulate_vs_mj_step_loop_four_bar": ("≥", 0.3),
    "plant_vs_real_time": ("≥", 30.0),
    "excitation_time_to_cond12_vs_slsqp_pin": ("≥", 4.0),
    "c_vs_pinocchio_cpp_ur5e": ("≥", 4.0),
    "c_vs_pinocchio_cpp_panda": ("≥", 4.0),
    "swarm_cost_vs_rows": ("≥", 1000.0),
    "swarm_search_vs_pymoo": ("≥", 5.0),
}
"""What each figure should reach; the others are there for orientation."""

_RELATIONS = {"≥": operator.ge, "≤": operator.le}

RUNS = (
    startup.run,
    command.run,
    regressor.run_pinocchio,
    regressor.run_figaroh,
    parameters.run_pinocchio,
    parameters.run_figaroh,
    memory.run,
    accuracy.run,
    decimation.run,
    pipeline.run,
    methods.run,
    consistency.run,
    model.run,
    simulation.run,
    c_code.run,
    plant.run,
    recorder.run,
    excitation.run,
    swarm.run_rows,
    swarm.run_peers,
)

MODULES = (
    regressor,
    parameters,
    memory,
    accuracy,
    decimation,
    startup,
    command,
    pipeline,
    methods,
    consistency,
    model,
    simulation,
    c_code,
    plant,
    recorder,
    excitation,
    swarm,
)


def main() -> None:
    """Run, print, write."""
    start = time.perf_counter()
    results: dict[str, float] = {"cores": os.cpu_count() or 1}
    print(environment())
    for run in RUNS:
        print(f"{run.__module__.removeprefix('benchmarks.')}.{run.__name__} …", file=sys.stderr, flush=True)
        results |= {name: float(f"{value:.4g}") for name, value in run().items()}
    RESULTS.write_text(json.dumps(results, indent=2) + "\n")
    print(table(results))
    print("\n" + "\n".join(module.COMPARED for module in MODULES))
    print(f"\n{RESULTS.name} written after {time.perf_counter() - start:.0f} s.")


def environment() -> str:
    """The machine and the versions, in one line."""
    packages = ", ".join(f"{name} {version(name)}" for name in ("numpy", "scipy", "pin", "figaroh", "h5py", "mcap"))
    machine = f"{os.cpu_count()} cores ({platform.machine()}), Python {platform.python_version()}"
    return f"{machine}, {packages}, 1 BLAS thread, compiled kernels: {kernels().said}"


def table(results: dict[str, float]) -> str:
    """Name, figure, goal and whether it is met, a line each."""
    lines = [f"{'name':<40}{'measured':>10}  {'goal':>7}  met"]
    for name, value in results.items():
        goal, met = "", ""
        if name in GOALS:
            relation, limit = GOALS[name]
            goal, met = f"{relation} {limit:g}", "yes" if _RELATIONS[relation](value, limit) else "no"
        lines.append(f"{name:<40}{value:>10.4g}  {goal:>7}  {met}")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
