"""LS, IRLS and I-IRLS on a simulated AUBO i5 that warms up, as AUBO .3.3 and .3.4 (docs/measurements/papers.md).

    python -m studies.papers.aubo_iirls [validation runs [ways, as experiment,estimated]]

A session (`aubo_session`): one excitation identifies, 25 other motions validate, while the joints warm up. Two ways to
know the temperature's part of the friction:

- *experiment*, the paper's: the excitation is played once, cold. f_T(T) − f_T(25 °C) comes from velocity sweeps, one
  joint at a time, at three temperatures, and is subtracted from the torques (eq. 7) of both sets.
- *estimated*: the excitation is played cold, in between and warm, and the temperature's coefficients are estimated with
  the rest.

Models I, II and III have no load term, a linear and a quadratic one. About ten minutes of CPU time.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from daq.motion.trajectories import Motion
from daq.recording.recording import JOINTS_STREAM, Recording
from daq.robot.loader import RobotFile
from drivers.core.arrays import FloatArray
from drivers.core.units import ZERO_CELSIUS
from ident.experiments.method_comparison import RunErrors, paired_difference
from ident.friction.table import TEMPERATURE_KINDS, power_law, temperature_factor
from ident.identify.identification import Identification, IdentifyChoices, ModelChoices
from ident.identify.identify import identify
from ident.tasks.comparison import ComparedModel, compare
from studies.papers.aubo_session import COLD, PERIOD, RATE, WARM, aubo, excitation, played, sweep, temperatures
from studies.synthetic.data_mistakes import with_values

MODELS = {
    "default": "coulomb-viscous",
    "I": "coulomb-viscous+power",
    "II": "coulomb-viscous+power+load-linear",
    "III": "coulomb-viscous+power+load",
}
SWEEP_FRICTION = "coulomb-viscous+power+load+temperature"
IDENTIFICATION_SEED, VALIDATION_SEED = 1, 100
TEMPERATURES = (COLD, 0.5 * (COLD + WARM), WARM)
"""Temperatures [°C] of the housings when the sweeps begin, and of the excitation where it is played three times."""
SMOOTHED = 21
"""Samples of the velocity's Savitzky-Golay filter, 0.1 s."""


@dataclass(frozen=True)
class Case:
    """A row of the tables.

    Attributes:
        name: in the paper's words.
        method: of dynid.
        model: I, II or III, or dynid's default.
        warm: whether the temperature's part of the friction is in the model.
    """

    name: str
    method: str
    model: str
    warm: bool


CASES = (
    Case("WLS", "wls", "default", False),
    Case("LS", "ols", "I", False),
    Case("WLS", "wls", "I", False),
    Case("IRLS", "iirls", "I", False),
    Case("I-IRLS", "iirls", "I", True),
    Case("I-IRLS", "iirls", "II", False),
    Case("I-IRLS", "iirls", "II", True),
    Case("I-IRLS", "iirls", "III", False),
    Case("I-IRLS", "iirls", "III", True),
    Case("LS", "ols", "III", True),
    Case("WLS", "wls", "III", True),
)
"""The paper's IRLS is I-IRLS with friction that depends on the velocity alone (Remark 3)."""


def without_temperature(recording: Recording, found: Identification) -> Recording:
    """The recording less the friction by which its temperatures differ from 25 °C, as a sweep identified it."""
    stream = recording.streams[JOINTS_STREAM]
    celsius, position = stream.channels["temperature"].values, stream.channels["position"].values
    current = stream.channels["current"]
    root = power_law(_velocity(position), 0.5)
    torque = np.zeros_like(position)
    for kind in TEMPERATURE_KINDS[1:]:
        for joint in range(position.shape[1]):
            (coefficient,) = (
                value
                for value, of_kind, of_joint in zip(
                    found.solution.parameters, found.base.kinds, found.base.joints, strict=True
                )
                if of_kind == kind and of_joint == joint
            )
            factor = temperature_factor(kind, celsius[:, joint] + ZERO_CELSIUS)
            torque[:, joint] += coefficient * factor * root[:, joint]
    robot = recording.robot().robot
    gains = np.array([robot.drive(name).gain for name in robot.joint_names], dtype=np.float64)
    return with_values(recording, current=current.values - torque / gains)


def _velocity(position: FloatArray) -> FloatArray:
    from scipy.signal import savgol_filter

    return np.asarray(savgol_filter(position, SMOOTHED, 3, deriv=1, delta=1.0 / RATE, axis=0))


def compared(case: Case, suffix: str, runs: Sequence[Recording], held_out: Sequence[Recording]) -> list[ComparedModel]:
    """The case's models, full and consistent, on the validation runs."""
    friction = MODELS[case.model] + suffix
    found = compare(runs, (case.method,), friction=(friction,), validation=held_out, delay=0.0)
    print(f"# {case}: {found.models[0].seconds:.0f} s", *found.failures, file=sys.stderr, flush=True)
    return list(found.models)


def print_table(rows: Sequence[tuple[Case, list[ComparedModel]]]) -> None:
    """RMSE of the full and of the consistent model; the rest of the full one: against IRLS, largest errors."""
    irls = next(models[0] for case, models in rows if case.name == "IRLS")
    largest = ("elbow low", "elbow high", "wrist low", "wrist high")
    heads = ("RMSE", "consistent", "low", "high", "against IRLS", *largest, "elbow high against IRLS")
    print(f"\n| | model | T | {' | '.join(heads)} |\n|{'---|' * (3 + len(heads))}")

    def against_irls(figure: Callable[[RunErrors], float], model: ComparedModel) -> str:
        first, second = ([figure(run) for run in one.runs] for one in (irls, model))
        paired = paired_difference(first, second)
        share, half = (100.0 * float(one / np.mean(first)) for one in (paired.mean, paired.half_width))
        return "" if model is irls else f"{share:+.1f} ± {half:.1f} %".replace("-", "−")

    for case, (full, *others) in rows:
        kinds = [np.mean([run.rmse for run in one.runs]) for one in (full, *others)]
        speeds = [np.mean([getattr(run, f"{speed}_speed_rmse") for run in full.runs]) for speed in ("low", "high")]
        cells = [f"{figure:.3f}" for figure in (*kinds, *speeds)]
        cells.append(against_irls(lambda run: run.rmse, full))
        for group in range(2):
            for speed in ("low_speed_max", "high_speed_max"):
                values = [getattr(run, speed)[group] for run in full.runs]
                cells.append(f"{np.mean(values):.2f} ({np.std(values, ddof=1):.2f})")
        cells.append(against_irls(lambda run: run.high_speed_max[0], full))
        print(f"| {case.name} | {case.model} | {'with' if case.warm else 'without'} | {' | '.join(cells)} |")
    sys.stdout.flush()


def by_experiment(
    arm: RobotFile, motion: Motion, held_out: Sequence[Recording]
) -> list[tuple[Case, list[ComparedModel]]]:
    """Identified cold; the temperature's part of the friction from sweeps."""
    friction = sweep(arm)
    sweeps = [played(arm, friction, celsius, seed) for seed, celsius in enumerate(TEMPERATURES, start=11)]
    choices = IdentifyChoices(model=ModelChoices(friction=SWEEP_FRICTION), search_delay=False)
    known = identify(sweeps, held_out[:1], choices)
    print(f"friction experiment: {len(sweeps)} sweeps of {friction.duration:.0f} s")
    for kind in TEMPERATURE_KINDS[1:]:
        columns = [index for index, of_kind in enumerate(known.base.kinds) if of_kind == kind]
        values = ", ".join(f"{known.solution.parameters[i]:.4f} ± {1.96 * known.std[i]:.4f}" for i in columns)
        print(f"  {kind}: {values}")
    cold = played(arm, motion, COLD, 1)
    less = without_temperature(cold, known), [without_temperature(run, known) for run in held_out]
    return [
        (case, compared(case, "", [less[0] if case.warm else cold], less[1] if case.warm else held_out))
        for case in CASES
    ]


def estimated(arm: RobotFile, motion: Motion, held_out: Sequence[Recording]) -> list[tuple[Case, list[ComparedModel]]]:
    """Identified cold, in between and warm, with the temperature's coefficients."""
    runs = [played(arm, motion, celsius, seed) for seed, celsius in enumerate(TEMPERATURES, start=1)]
    return [(case, compared(case, "+temperature" * case.warm, runs, held_out)) for case in CASES]


def main(count: int = 25, ways: str = "experiment,estimated") -> None:
    """Print the tables."""
    arm = aubo()
    motion = excitation(arm, IDENTIFICATION_SEED, candidates=30)
    held_out = []
    for k in range(count):
        other = excitation(arm, VALIDATION_SEED + k, candidates=1)
        held_out.append(played(arm, other, temperatures(k / (count - 1)), VALIDATION_SEED + k))
    speed = np.concatenate([_velocity(run.streams[JOINTS_STREAM].channels["position"].values) for run in held_out])
    print(f"{count} validation runs of {PERIOD:g} s; rms speed {np.sqrt(np.mean(speed**2, axis=0)).round(2)} rad/s")
    for way in ways.split(","):
        rows = (by_experiment if way == "experiment" else estimated)(arm, motion, held_out)
        print_table(rows)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 25, *sys.argv[2:3])
