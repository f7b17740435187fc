"""Mistakes in the data, and what `dynid identify` makes of them (docs/measurements/checks.md).

    python -m studies.checks.data_mistakes table ../shared/data
    python -m studies.checks.data_mistakes sound 5

`table`: simulated arms (20 s at 250 Hz) and the public recordings, each with one mistake after the other: held-out
error, and the checks on data and model that were raised. `sound`: simulated arms without any mistake, as many seeds of
four arms as the number says; counts those that raise a check on data. All with plain friction, which is quick.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

import dynid
from daq.importers.choices import ImportChoices
from daq.importers.import_file import import_file
from daq.recording.recording import JOINTS_STREAM, Recording
from daq.robot.loader import RobotFile, parse_robot
from drivers.core.errors import DynidError
from studies.synthetic import data_mistakes as mistakes

SIMULATED = ("ur5e", "rocr6", "panda", "up6")
DATA_CHECKS = (
    "encoder-stuck", "rows-repeated", "filled-with-zeros", "residual-bursts", "positions-jitter", "many-outliers",
    "clocks-drift",
)  # fmt: skip
MODEL_CHECKS = (
    "gravity-opposite", "gravity-other-axis", "gravity-tilted", "torque-sign", "torques-opposite", "torques-exchanged",
    "inconsistent-gain", "inconsistent-length",
)  # fmt: skip
"""Checks that blame the model for what is wrong with the data."""


def at_fifty_hertz(run: Recording) -> Recording:
    """The recording with 50 samples a second or as many as it has."""
    return mistakes.sampled(run, max(1, round(0.02 / float(np.median(np.diff(run.streams[JOINTS_STREAM].time))))))


def third(run: Recording) -> float:
    """A third of the duration [s]."""
    time = run.streams[JOINTS_STREAM].time
    return float(time[-1] - time[0]) / 3.0


MISTAKES: dict[str, Callable[[Recording], Recording]] = {
    "none": lambda run: run,
    "an encoder stands still for 1 s": lambda run: mistakes.stuck_encoder(run, 1, third(run), 1.0),
    "13 % of the rows repeat the one before": lambda run: mistakes.repeated_rows(run, 0.13, 1),
    "30 % of the positions repeat": lambda run: mistakes.repeated_rows(run, 0.3, 1, ("position",)),
    "contacts in 5 % of the time": lambda run: mistakes.contact(run, 0.05, 1.0, 1),
    "drop-outs of 90 % filled with zeros": lambda run: mistakes.filled_with_zeros(run, 0.9, 1),
    "positions jitter by 4 ms": lambda run: mistakes.jittering_position(run, 0.004, 1),
    "positions jitter by 15 ms": lambda run: mistakes.jittering_position(run, 0.015, 1),
    "50 Hz, jitter of 4 ms": lambda run: mistakes.jittering_position(at_fifty_hertz(run), 0.004, 1),
    "50 Hz, jitter of 15 ms": lambda run: mistakes.jittering_position(at_fifty_hertz(run), 0.015, 1),
}


def public_recordings(folder: Path) -> Iterator[tuple[str, Recording, dict[str, object]]]:
    """The recordings of three real arms, with options that they need."""

    def arm(name: str, joints: list[str]) -> RobotFile:
        lines = "".join(f"  - {{name: {joint}, position: [-6.2832, 6.2832], velocity: 6}}\n" for joint in joints)
        return parse_robot(f"name: {name}\nmodel: {{urdf: {name}.urdf}}\njoints:\n{lines}", where=name, folder=folder)

    ur10 = ["shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", *(f"wrist_{k}_joint" for k in (1, 2, 3))]
    tx40 = (Path(__file__).parents[2] / "examples" / "tx40.yaml").read_text(encoding="utf-8")
    files: list[tuple[str, str, RobotFile, dict[str, object]]] = [
        ("UR10", "ur10_unisa1.npz", arm("ur10", ur10), {}),
        ("Panda", "panda_gaz1.npz", arm("panda", [f"joint_{k}" for k in range(1, 8)]), {"motor_inertia": False}),
        ("TX40", "tx40_t1.npz", parse_robot(tx40, where="tx40", folder=folder), {}),
    ]
    for name, file, robot, options in files:
        yield name, import_file(folder / file, robot, ImportChoices()), options


def figures(run: Recording, options: dict[str, object]) -> str:
    """Held-out error and the checks on data and model."""
    try:
        result = dynid.identify(run, friction="coulomb-viscous", **options)  # type: ignore[arg-type]
    except DynidError as refusal:
        return f"refused: {refusal}"
    raised = [check.name for check in result.verdict.checks]
    named = [f"`{name}`" for name in dict.fromkeys(raised) if name in DATA_CHECKS]
    blamed = [f"**{name}**" for name in dict.fromkeys(raised) if name in MODEL_CHECKS]
    error = float("nan") if result.validation is None else 100.0 * result.validation.relative_error
    return f"{error:.3g} % {', '.join([*named, *blamed])}".strip()


def table(folder: Path) -> None:
    """Mistake by arm."""
    runs: list[tuple[str, Recording, dict[str, object]]] = [
        (f"{name}, simulated", dynid.simulate(name, duration=20.0, seed=1, rate=250.0), {}) for name in SIMULATED[:2]
    ]
    runs += list(public_recordings(folder))
    print(f"| mistake | {' | '.join(name for name, _, _ in runs)} |\n|---|{'---|' * len(runs)}", flush=True)
    for what, mistake in MISTAKES.items():
        cells = [figures(mistake(mistakes.with_velocity(run)), options) for _, run, options in runs]
        print(f"| {what} | {' | '.join(cells)} |", flush=True)


def sound(seeds: int) -> None:
    """False alarms on simulated arms without a mistake."""
    alarms = {}
    for name in SIMULATED:
        for seed in range(1, seeds + 1):
            run = mistakes.with_velocity(dynid.simulate(name, duration=15.0, seed=seed, rate=200.0))
            checks = {check.name for check in dynid.identify(run, friction="coulomb-viscous").verdict.checks}
            if wrong := checks & {*DATA_CHECKS, *MODEL_CHECKS}:
                alarms[f"{name}, seed {seed}"] = sorted(wrong)
    print(f"{len(alarms)} of {len(SIMULATED) * seeds} recordings raise a check: {alarms}")


if __name__ == "__main__":
    if sys.argv[1] == "table":
        table(Path(sys.argv[2]))
    else:
        sound(int(sys.argv[2]))
