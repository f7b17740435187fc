"""Every method's estimate of 20,000 samples, as a multiple of ordinary least squares'."""

from __future__ import annotations

from functools import partial

from benchmarks.timing import medians
from daq.robot.loader import load_robot
from drivers.core.errors import DynidError
from ident.estimators.estimator import Setup
from ident.estimators.method_choice import all_methods, chosen_method
from ident.identify.identification import IdentifyChoices
from ident.identify.identify import identify
from ident.model.dynamic_model import build_model
from ident.model.regressor import RegressorKernel
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording

COMPARED = """\
method_NAME_vs_ols: from prepared data (UR5e, 20,000 samples at 500 Hz, decimated by the parallel filter) to parameters,
  without error bars; default options; times as multiples of that of ols, in the same rounds."""


SAMPLES, RATE, PERIOD = 20_000, 500.0, 15.0


def run(samples: int = SAMPLES, rounds: int = 3) -> dict[str, float]:
    """Times of all methods over that of OLS."""
    robot_file = load_robot("ur5e")
    motion = random_fourier_motion(build_model(robot_file), PERIOD, seed=1)
    recording = simulate_recording(robot_file, motion, samples / RATE / 0.7, seed=1)
    known = identify([recording], [], IdentifyChoices("ols", search_delay=False))
    setup = Setup(
        RegressorKernel(known.model, known.base.columns),
        known.base,
        known.experiment,
        robot_file,
        tuple(run.prepared for run in known.runs),
    )
    sides = {}
    for name in all_methods():
        try:
            _estimate(setup, name)
        except DynidError:  # what the method needs, as a controller, is not there
            continue
        sides[name] = partial(_estimate, setup, name)
    seconds = medians(sides, rounds, warm_up=False)
    return {f"method_{name}_vs_ols": of / seconds["ols"] for name, of in seconds.items() if name != "ols"}


def _estimate(setup: Setup, text: str) -> object:
    estimator = chosen_method(text).estimator(setup)
    plain = estimator.reduce(setup.runs)
    return estimator.estimate(setup.runs, plain, tuple(range(len(setup.kernel.columns))))
