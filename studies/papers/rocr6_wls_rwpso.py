"""The WLS-RWPSO paper on the ROCR6: Table 3 and Figure 4 of our own, least squares beside them.

`python -m studies.papers.rocr6_wls_rwpso [SECONDS]` prints tables of docs/measurements/papers.md; the excitation is
designed for SECONDS (30). `--page DIR` as the last arguments writes the reports of the methods, too.

The arm has Table 2's values for joints 1 to 3 and the wrist of our robot file. With the printed signs its inertia
matrix is not positive definite everywhere; it is with links 2 and 3 turned by π about their joints' axes, which
reverses MX, MY, XZ and YZ: the printed table has another zero position than Table 1. Fourier series of order 5 and
0.05 Hz, 20 s at 1 kHz, the encoder steps and the torque noise of the robot file.
"""

from __future__ import annotations

import os
import sys
from copy import copy
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy.optimize import lsq_linear

import dynid
from daq.motion.trajectories import Motion, RestToRest
from daq.recording.recording import Recording
from daq.robot.loader import load_robot
from drivers.core.arrays import FloatArray
from ident.estimators.swarm.minimisation import SearchBox, SearchBudget, minimise
from ident.estimators.swarm.particle_swarm import ConstantWeight, ParticleSwarm, RandomWeight
from ident.estimators.swarm.physical import QuadraticCost
from ident.identify.identification import Identification, IdentifyChoices, ModelChoices
from ident.identify.identify import identify
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import build_model
from ident.model.dynamics.inverse_dynamics import InverseDynamics
from ident.model.regressor import model_torque
from ident.model.true_parameters import truth_vector
from ident.signals.options import Differentiation, PreprocessChoices
from ident.signals.smoothing.five_point import five_point_cubic
from ident.signals.smoothing.kalman import WHITE_CURVATURE, kalman_smoother, likeliest_cutoff
from ident.simulation.forward_arm import ForwardArm
from sim_drivers.synthetic.measurement import random_fourier_motion

ROCR6 = load_robot("rocr6")
MODEL = replace(build_model(ROCR6), motor_inertia=(False,) * 6)
BASE = base_parameters(MODEL)
TABLE_2 = {
    "ZZ1": 4.4672, "XX2": -1.4213, "XY2": -0.0502, "XZ2": -0.3501, "YZ2": 0.6224, "ZZ2": 3.1617, "MX2": 4.4642,
    "MY2": 0.0724, "XX3": -0.7103, "XY3": -0.1641, "XZ3": -0.1513, "YZ3": 0.0932, "ZZ3": 0.7253, "MX3": 1.9305,
    "MY3": 0.0057, "Fs1": 18.3420, "Fv1": 8.5743, "Fs2": 15.7401, "Fv2": 9.2475, "Fs3": 20.7765, "Fv3": 9.5148,
}  # fmt: skip
TURNED = ("MX", "MY", "XZ", "YZ")
TABLE_3 = {
    "LS-PSO": (0.3816, 0.2478, 0.4012, 0.2186, 0.1937, 0.3506),
    "WLS-PSO": (0.3661, 0.2325, 0.3986, 0.2035, 0.1867, 0.3462),
    "WLS-RWPSO": (0.3502, 0.2080, 0.3524, 0.1671, 0.1610, 0.3148),
}
PERIOD, RATE = 20.0, 1000.0
SEEDS = range(20)
PAPER = "particles=200:generations=200:c1=1.5:c2=3"
METHODS = {
    "ols": "ols",
    "wls": "wls",
    "LS-PSO, paper's settings": f"ls-pso:{PAPER}:weight=1.3",
    "WLS-PSO, paper's settings": f"wls-pso:{PAPER}:weight=1.3",
    "WLS-RWPSO, paper's c1, c2": f"wls-rwpso:{PAPER}",
    "LS-PSO, stable settings": "ls-pso:particles=200",
    "WLS-PSO, stable settings": "wls-pso:particles=200",
    "WLS-RWPSO, stable settings": "wls-rwpso:particles=200",
}


def true_base(*, turned: bool = True) -> FloatArray:
    """Base parameters (b,) of the simulated arm."""
    names = [parameter.name for parameter in build_model(ROCR6).parameters]
    places = [names.index(parameter.name) for parameter in MODEL.parameters]
    values = BASE.projection @ truth_vector(ROCR6)[places]
    for index, name in enumerate(BASE.names):
        symbol = name.replace("R", "")
        if symbol in TABLE_2:
            values[index] = TABLE_2[symbol] * (-1.0 if turned and symbol[:2] in TURNED else 1.0)
    return values


def indefinite(values: FloatArray) -> tuple[float, float]:
    """Smallest eigenvalue of the inertia matrix over random poses, and the share of poses where it is negative."""
    arm = ForwardArm(InverseDynamics(MODEL, BASE, values))
    poses = np.random.default_rng(1).uniform(-np.pi, np.pi, (1000, 6))
    least = np.array([np.linalg.eigvalsh(arm.inertia(pose))[0] for pose in poses])
    return float(least.min()), float(np.mean(least < 0))


class Data:
    """20 s of a motion at full speed: what is recorded, and what was true."""

    def __init__(self, motion: Motion, truth: FloatArray, seed: int) -> None:
        self.time = np.arange(round(PERIOD * RATE)) / RATE
        self.states = motion.evaluate(self.time)
        self.clean = model_torque(MODEL, BASE.columns, truth, *self.states)
        noise = ROCR6.robot.truth.noise
        spread = np.array([noise.torque_std[name] for name in ROCR6.robot.joint_names])[:, None]
        self.torque = self.clean + spread * np.random.default_rng(seed).standard_normal(self.clean.shape)
        step = noise.encoder_resolution
        self.position = step * np.round(self.states[0] / step)

    @property
    def recording(self) -> Recording:
        return Recording.from_arrays(ROCR6, time=self.time, position=self.position.T, torque=self.torque.T)

    def rms(self, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """RMS (n,) of the torque error against the recorded and against the true torque [N·m]."""
        predicted = model_torque(MODEL, BASE.columns, values, *self.states)
        recorded, true = (np.sqrt(np.mean((torque - predicted) ** 2, axis=1)) for torque in (self.torque, self.clean))
        return recorded, true


def identified(
    data: Data, held_out: Data, method: str, differentiation: Differentiation = "butterworth"
) -> Identification:
    preprocess = PreprocessChoices(differentiation=differentiation)
    choices = IdentifyChoices(
        method=method, model=ModelChoices(motor_inertia=False), preprocess=preprocess, search_delay=False
    )
    return identify([data.recording], [held_out.recording], choices)


def preprocessing(data: Data, held_out: Data) -> None:
    """Figure 2: the torque smoothed before the identification, and ways to q̇ and q̈."""
    smoothed = {"as recorded": data.torque, "five-point cubic, 3 passes": five_point_cubic(data.torque, 3)}
    kalman = []
    for torque in data.torque:
        cutoff = likeliest_cutoff(torque, RATE, WHITE_CURVATURE, 1.0)
        kalman.append(kalman_smoother(torque, RATE, cutoff, WHITE_CURVATURE)[0])
    smoothed["Kalman smoother"] = np.array(kalman)
    print(f"\n{'torque':28} {'q̇, q̈':12} RMS error of the torque signal [N·m], then of WLS on the validation trajectory")
    for name, torque in smoothed.items():
        signal = np.sqrt(np.mean((torque - data.clean) ** 2, axis=1))
        changed = copy(data)
        changed.torque = torque
        for way in ("butterworth", "kalman", "five-point"):
            values = identified(changed, held_out, "wls", way).solution.parameters
            errors = held_out.rms(values)[1]
            print(
                f"{name:28} {way:12} "
                + " ".join(f"{v:6.3f}" for v in signal)
                + "  "
                + " ".join(f"{v:6.4f}" for v in errors),
                flush=True,
            )


def least_within(cost: QuadraticCost, box: SearchBox) -> FloatArray:
    """The exact optimum x (d,) of a box."""
    # Variables scaled to the box: the solver's tolerances are absolute.
    scaled = lsq_linear(
        cost.root * box.width,
        cost.target - cost.root @ box.lower,
        bounds=(np.zeros(box.size), np.ones(box.size)),
        method="bvls",
        tol=1e-14,
        max_iter=100 * box.size,
    )
    return box.clip(box.lower + box.width * scaled.x)


def convergence(data: Identification) -> None:
    """Figure 4: PSO against RWPSO on the weighted cost within ±10 % of WLS."""
    solution = data.solution
    active = list(solution.active)
    cost = QuadraticCost.of_reduction(data.reduction, active, solution.weights)
    exact = solution.parameters[active]
    box = SearchBox.around(exact, 0.1)
    least = cost.cost(exact)
    inside = cost.cost(least_within(cost, box))
    print(f"\nWLS: cost {least:.4f}; least within the box {inside:.4f}; {len(active)} parameters")
    cases = {
        "PSO, paper: W 1.3, c1 1.5, c2 3": ParticleSwarm(200, ConstantWeight(1.3), 1.5, 3.0),
        "RWPSO, paper: c1 1.5, c2 3": ParticleSwarm(200, RandomWeight(), 1.5, 3.0),
        "… velocity clamp 0.1": ParticleSwarm(200, RandomWeight(), 1.5, 3.0, 0.1),
        "PSO, W 0.65, c1 1.5, c2 3": ParticleSwarm(200, ConstantWeight(0.65), 1.5, 3.0),
        "PSO, stable: W 0.73, c 1.5": ParticleSwarm(200),
        "RWPSO, stable: μ 0.5 to 0.8, c 1.5": ParticleSwarm(200, RandomWeight()),
        "RWPSO, μ 0.4 to 0.6, σ 0.1, c 1.5": ParticleSwarm(200, RandomWeight(0.4, 0.6, 0.1)),
    }
    print(
        f"{'swarm of 200, 200 generations':36} {'mean':>6} {'var.':>6} {'initial cost':>13} {'to 1 % of final':>16}"
        f" {'above WLS, median [%]':>22} {'worst':>8} {'within 1 % of WLS: seeds, generations':>38}"
    )
    for name, swarm in cases.items():
        found = [minimise(swarm, cost, box, SearchBudget(200), seed) for seed in SEEDS]
        own = np.median([one.generations_to(1.01 * one.cost) or 0 for one in found])
        above = 100.0 * (np.array([one.cost for one in found]) / least - 1.0)
        near = [generation for one in found if (generation := one.generations_to(1.01 * least)) is not None]
        print(
            f"{name:36} {swarm.stability.mean:6.3f} {swarm.stability.variance:6.3f}"
            f" {np.median([one.history[0] for one in found]):13.1f} {own:16.0f} {np.median(above):22.4g}"
            f" {above.max():8.3g} {len(near):20d}, {np.median(near) if near else np.nan:15.0f}",
            flush=True,
        )


def table_3(data: Data, held_out: Data, truth: FloatArray, folder: Path | None) -> None:
    """RMS of the torque error on the validation trajectory."""
    print(f"\n{'Table 3, RMS against recorded [N·m]':34} " + " ".join(f"{f'joint {j}':>8}" for j in range(1, 7)))
    for name, values in TABLE_3.items():
        print(f"{'printed: ' + name:34} " + " ".join(f"{value:8.4f}" for value in values))
    rows: dict[str, FloatArray] = {"true parameters": truth}
    for name, method in METHODS.items():
        rows[name] = identified(data, held_out, method).solution.parameters
        if folder is not None and "," not in name:
            run, other = data.recording, held_out.recording
            dynid.identify(run, validation=other, method=method, motor_inertia=False, delay=0.0).save(folder / name)
    for column, against in enumerate(("recorded", "true")):
        if column:
            print("RMS against the true torque [N·m]")
        for name, parameters in rows.items():
            error = held_out.rms(parameters)[column]
            print(f"{name:34} " + " ".join(f"{value:8.4f}" for value in error), f"  ({against})", flush=True)


def main() -> None:
    arguments = sys.argv[1:]
    folder = Path(arguments[-1]) if "--page" in arguments else None
    seconds = float(arguments[0]) if arguments and arguments[0] != "--page" else 30.0
    for turned in (False, True):
        least, share = indefinite(true_base(turned=turned))
        signs = "turned by π" if turned else "as printed"
        print(f"Table 2 {signs}: smallest eigenvalue of M {least:.4g}, negative at {100 * share:.1f} % of random poses")
    truth = true_base()
    designed = dynid.design_excitation(
        "rocr6", criterion="plain-condition", harmonics=5, period=PERIOD, time=seconds, self_collision=False
    )
    assert designed.design is not None
    assert isinstance(designed.motion, RestToRest)
    motion = designed.motion.motion  # without its ramps
    print(f"excitation: condition number of W {designed.design.cost:.1f} after {seconds:g} s")
    data = Data(motion, truth, 1)
    held_out = Data(random_fourier_motion(MODEL, PERIOD, seed=5, candidates=20), truth, 2)
    preprocessing(data, held_out)
    convergence(identified(data, held_out, "wls"))
    table_3(data, held_out, truth, folder)


if __name__ == "__main__":
    main()
