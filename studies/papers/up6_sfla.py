"""The SFLA paper on the UP6: Tables 2 to 4 and Figures 5 and 9 to 16 of our own, least squares beside them.

`python -m studies.papers.up6_sfla` prints the tables of docs/measurements/papers.md (20 seeds, about 5 minutes).
`python -m studies.papers.up6_sfla --page DIR` also writes DIR/figures.html and the reports of `sfla` and `wls`.

Joints 1 to 3 follow the paper's excitation (Table 1) in closed loop under PID controllers, their gains so stiff that
the ratios of torque to position errors are those of Table 4. Position, velocity, acceleration and torque of each step
of 0.5 ms are the identification data; they have no noise, as in the paper.
"""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

import dynid
from daq.robot.loader import load_robot
from drivers.core.arrays import FloatArray
from ident.estimators.swarm.frog_leaping import FrogLeaping
from ident.estimators.swarm.minimisation import Minimum, Optimiser, SearchBox, SearchBudget, minimise
from ident.estimators.swarm.particle_swarm import ParticleSwarm
from ident.estimators.swarm.physical import (
    PhysicalCost,
    PhysicalParameters,
    QuadraticCost,
    identifiability,
    physical_values,
)
from ident.excite.choices import DesignChoices
from ident.excite.design import design
from ident.excite.prior import find_prior
from ident.excite.search.search import SearchChoices, SearchResult
from ident.linear_algebra.triangular import GramAccumulator
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import build_model
from ident.model.dynamics.inverse_dynamics import InverseDynamics
from ident.model.regressor import regressor
from ident.model.true_parameters import truth_vector
from ident.simulation.forward_arm import ForwardArm
from ident.simulation.time_stepping import SteppedMotion, integrate
from studies.methods.library_optimisers import CmaEs, DifferentialEvolution
from studies.papers.up6_excitation import PAPER

UP6 = load_robot("up6")
MODEL = build_model(UP6)
BASE = base_parameters(MODEL)
TRUTH = truth_vector(UP6)
PHYSICAL = physical_values(MODEL, TRUTH)

TABLE_3 = {
    "m1": 55.9035, "m2": 35.1481, "m3": 34.9386,
    "Izz1": 1.2740, "Izz2": 0.7077, "Izz3": 0.7000,
    "Fs1": 13.5045, "Fs2": 2.2423, "Fs3": 14.2434,
    "Fv1": 30.0105, "Fv2": 10.7523, "Fv3": 16.1701,
}  # fmt: skip
"""The paper's estimates; its I1yy, I2zz, I3yy are about the joints' axes, zz in our frames."""

PARAMETERS = PhysicalParameters.of(MODEL, PHYSICAL, tuple(TABLE_3))
VALUES = PHYSICAL[list(PARAMETERS.chosen)]

STIFFNESS = np.array([6.9587 / 1.30e-4, 2.0493 / 4.03e-6, 4.2899 / 2.01e-5])
"""[N·m/rad] Table 4's torque over its position errors."""

INTEGRAL = 10.0
"""[1/s] integral over proportional gain."""

DURATION, STEP = 10.0, 5e-4
STILL = 1e-3
"""[rad/s] below which a joint may stick."""

SEEDS = range(20)
TABLE_2 = FrogLeaping()
GENERATIONS = 50


def closed_loop(base: FloatArray) -> SteppedMotion:
    """The arm with these base parameters under the controllers, from a start on the trajectory."""
    arm = ForwardArm(InverseDynamics(MODEL, BASE, base))
    steps = round(DURATION / STEP)
    position, velocity, _ = (signal.T for signal in PAPER.evaluate(np.linspace(0.0, DURATION, steps + 1)))
    damping = 2.0 * np.sqrt(STIFFNESS * np.diagonal(arm.inertia(position.mean(axis=0))))
    total = np.zeros(3)

    def drive(now: float, q: FloatArray, rate: FloatArray) -> FloatArray:
        nonlocal total
        index = round(now / STEP)
        error = position[index] - q
        total = total + STEP * error
        return np.asarray(STIFFNESS * (error + INTEGRAL * total) + damping * (velocity[index] - rate))

    return integrate(arm, position[0], velocity[0], drive, DURATION, steps)


def identification_data(motion: SteppedMotion) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Position, velocity, acceleration and torque (n, N) in the middle of the steps; without those that reverse.

    There friction is anything up to Coulomb friction.
    """
    q, v = motion.position.T, motion.velocity.T
    middle = q[:, :-1] + 0.5 * STEP * v[:, :-1]
    keeps = np.all(
        (np.sign(v[:, 1:]) == np.sign(v[:, :-1])) & (np.minimum(*np.abs([v[:, 1:], v[:, :-1]])) > STILL), axis=0
    )
    mean, change = 0.5 * (v[:, 1:] + v[:, :-1]), np.diff(v) / STEP
    return middle[:, keeps], mean[:, keeps], change[:, keeps], motion.torque.T[:, :-1][:, keeps]


@dataclass(frozen=True)
class Problem:
    """The cost of eq. 10 in Table 3's parameters, and the torque equations behind it."""

    cost: PhysicalCost
    samples: int

    @classmethod
    def of(cls, motion: SteppedMotion) -> Problem:
        """Make the problem from data of the closed loop."""
        q, v, a, torque = identification_data(motion)
        rows = regressor(MODEL, q, v, a, BASE.columns)
        gram = GramAccumulator(BASE.count + 1)
        for joint in range(3):
            gram.add(np.vstack([rows[joint], torque[joint]]))
        factor = gram.factor()
        quadratic = QuadraticCost(factor[:-1, :-1], factor[:-1, -1], float(factor[-1, -1] ** 2))
        return cls(PhysicalCost(PARAMETERS, quadratic, BASE.projection), q.shape[1])

    def rms(self, cost: float) -> float:
        """Root mean square torque error [N·m] over all joints."""
        return float(cost / np.sqrt(3 * self.samples))


def joint_rms(first: SteppedMotion, second: SteppedMotion) -> tuple[FloatArray, FloatArray]:
    """Table 4: RMS difference of position [rad] and torque [N·m] per joint."""
    return tuple(
        np.sqrt(np.mean((getattr(first, name) - getattr(second, name)) ** 2, axis=0)) for name in ("position", "torque")
    )


def row(name: str, values: FloatArray, form: str = "10.4f") -> None:
    print(f"{name:34} " + " ".join(f"{value:{form}}" for value in values), flush=True)


def runs(problem: Problem, optimiser: Optimiser, box: SearchBox, generations: int = GENERATIONS) -> list[Minimum]:
    return [minimise(optimiser, problem.cost, box, SearchBudget(generations), seed=seed) for seed in SEEDS]


def compare(problem: Problem, cases: dict[str, tuple[Optimiser, SearchBox, int]]) -> dict[str, list[Minimum]]:
    """Median, best and worst of the seeds for each case."""
    print(
        f"\n{'optimiser, box':34} {'RMS torque [N·m]: median, best, worst':>38} {'to 1 % of final':>16}"
        f" {'costs':>7} {'|error| [%]':>11} {'m1':>8} {'m2, m3':>8} {'friction':>8}"
    )
    found = {}
    for name, (optimiser, box, generations) in cases.items():
        results = found[name] = runs(problem, optimiser, box, generations)
        errors = 100.0 * np.abs(np.array([result.point for result in results]) / VALUES - 1.0)
        rms = np.array([problem.rms(result.cost) for result in results])
        near = np.median([result.generations_to(1.01 * result.cost) or 0 for result in results])
        print(
            f"{name:34} {np.median(rms):14.4g} {rms.min():11.4g} {rms.max():11.4g} {near:16.0f}"
            f" {np.median([r.evaluations[-1] for r in results]):7.0f} {np.median(errors):11.3g}"
            f" {np.median(errors[:, 0]):8.3g} {np.median(errors[:, 1:3]):8.3g} {np.median(errors[:, 6:]):8.3g}",
            flush=True,
        )
    return found


def tables(problem: Problem, true: SteppedMotion) -> tuple[dict[str, SteppedMotion], FloatArray]:
    """Print everything; the closed loops for the figures."""
    print(f"{problem.samples} samples of {DURATION:g} s; parameters: {', '.join(TABLE_3)}")
    wide, narrow = SearchBox(np.zeros(12), 2.0 * VALUES), SearchBox.around(VALUES, 0.1)
    half = SearchBox.around(VALUES, 0.5)
    coordinate = FrogLeaping(random="coordinate")
    found = compare(
        problem,
        {
            "SFLA, Table 2, 0 to 200 %": (TABLE_2, wide, GENERATIONS),
            "SFLA, Table 2, ±50 %": (TABLE_2, half, GENERATIONS),
            "SFLA, Table 2, ±10 %": (TABLE_2, narrow, GENERATIONS),
            "SFLA, r per coordinate, 0 to 200 %": (coordinate, wide, GENERATIONS),
            "… 500 generations": (coordinate, wide, 500),
            "PSO, 50 particles, 0 to 200 %": (ParticleSwarm(), wide, 110),
            "differential evolution": (DifferentialEvolution(), wide, 110),
            "CMA-ES": (CmaEs(), wide, 110),
        },
    )
    truth_cost = problem.cost(VALUES[None])[0]
    paper = np.array(list(TABLE_3.values()))
    print(f"\nRMS torque error of the true parameters {problem.rms(truth_cost):.3g} N·m", end="")
    print(f", of the paper's estimates {problem.rms(problem.cost(paper[None])[0]):.4g} N·m")

    derivative = problem.cost.derivative(VALUES)
    print("\nidentifiability (of the 12 parameters; of 11, m1 known):")
    whole = identifiability(derivative, 1.0, tuple(TABLE_3))
    rest = identifiability(derivative[:, 1:], 1.0, tuple(TABLE_3)[1:])
    known = {p.name: p for p in rest}
    for parameter, value in zip(whole, VALUES, strict=True):
        other = known.get(parameter.name)
        print(
            f"  {parameter.name:5} determined {parameter.determined:6.4f}; σ for 1 N·m of white noise"
            f" {100 * parameter.std / value:8.3g} %, m1 known {100 * other.std / value if other else np.nan:8.3g} %"
            f"  {'with ' + ', '.join(parameter.confounded_with) if parameter.confounded_with else ''}"
        )

    # Linear in these parameters: a least-squares problem with 12 columns, one of them dependent.
    offset = problem.cost.parameters.standard(np.zeros((1, 12)))[0]
    target = problem.cost.quadratic.target - problem.cost.quadratic.root @ (BASE.projection @ offset)
    fixed = np.linalg.lstsq(derivative[:, 1:], target - derivative[:, 0] * VALUES[0], rcond=None)[0]
    print(f"\nleast squares, m1 known: largest error {100 * np.max(np.abs(fixed / VALUES[1:] - 1)):.3g} %")
    exact = problem.cost.quadratic.least()
    print(
        f"least squares on the {BASE.count} base parameters: RMS {problem.rms(problem.cost.quadratic.cost(exact)):.3g}"
        f" N·m, largest error {np.max(np.abs(exact - BASE.projection @ TRUTH)):.3g}"
    )

    results = found["SFLA, Table 2, ±50 %"]
    order = np.argsort([result.cost for result in results])
    middle = results[int(order[len(order) // 2])]
    print(f"\n{'Table 3':34} " + " ".join(f"{name:>10}" for name in TABLE_3))
    row("true", VALUES)
    row("the paper's estimate", paper)
    row("SFLA ±50 %, seed of median cost", middle.point)
    row("SFLA ±50 %, median |error| [%]", np.median([100 * np.abs(r.point / VALUES - 1) for r in results], axis=0))
    row("the paper's |error| [%]", 100 * np.abs(paper / VALUES - 1))
    row("least squares, m1 known", np.array([VALUES[0], *fixed]))

    loops = {
        "the paper's estimate": closed_loop(problem.cost.base(paper[None])[0]),
        "SFLA": closed_loop(problem.cost.base(middle.point[None])[0]),
        "least squares": closed_loop(exact),
    }
    print(f"\n{'Table 4':34} {'position 1..3 [rad]':>32} {'torque 1..3 [N·m]':>32}")
    print(f"{'as printed':34} " + " ".join(f"{v:10.3g}" for v in (1.3e-4, 4.03e-6, 2.01e-5, 6.9587, 2.0493, 4.2899)))
    for name, motion in loops.items():
        row(name, np.concatenate(joint_rms(true, motion)), "10.3g")
    boxes = {"±50 %": found["SFLA, Table 2, ±50 %"], "±10 %": found["SFLA, Table 2, ±10 %"]}
    for box, several in boxes.items():
        errors = [np.concatenate(joint_rms(true, closed_loop(problem.cost.base(r.point[None])[0]))) for r in several]
        row(f"SFLA {box}, median of 20 seeds", np.median(errors, axis=0), "10.3g")
    return loops, middle.history


def excitation_history() -> tuple[list[float], list[float]]:
    """Time [s] and J of the motions that SFLA found one after the other: eq. 12 on the paper's sums of 3 sines."""
    choices = DesignChoices(kind="sines", criterion="motion-size", harmonics=3)
    told: list[tuple[float, float]] = []

    def remember(result: SearchResult) -> None:
        if result.best is not None:
            told.append((result.seconds, float(np.exp(result.best.cost))))

    design(UP6, find_prior(UP6), choices, SearchChoices(starts=1, workers=1, solver="sfla"), progress=remember)
    return [seconds for seconds, _ in told], [size for _, size in told]


def page(folder: Path, true: SteppedMotion, loops: dict[str, SteppedMotion], history: FloatArray) -> None:
    """Figures 5 and 9 to 16, and two reports."""
    import plotly.graph_objects as go
    from plotly.subplots import make_subplots

    folder.mkdir(parents=True, exist_ok=True)
    every = slice(None, None, 20)
    time, wanted = true.time[every], PAPER.evaluate(true.time[every])[0]
    titles = [
        "Fig. 5: J of the best motion so far by time [s], SFLA",
        "cost ‖E‖ of the identification by generation, SFLA",
    ]
    titles += [f"Fig. 9: closed loop, joint {j} [rad]" for j in (1, 2, 3)]
    titles += [f"Fig. 10: position error, joint {j} [rad]" for j in (1, 2, 3)]
    titles += [f"Fig. {10 + j}: estimated minus true position, joint {j} [rad]" for j in (1, 2, 3)]
    titles += [f"Fig. {13 + j}: torque, joint {j} [N·m]" for j in (1, 2, 3)]
    figure = make_subplots(rows=len(titles), cols=1, subplot_titles=titles, vertical_spacing=0.02)
    seconds, sizes = excitation_history()
    figure.add_scatter(x=seconds, y=sizes, row=1, col=1, name="J", showlegend=False)
    figure.add_scatter(y=history, row=2, col=1, name="cost", showlegend=False)
    figure.update_yaxes(type="log", row=1, col=1)
    figure.update_yaxes(type="log", row=2, col=1)
    colours = {"reference": "#7C828A", "true arm": "#000000"}
    colours |= dict(zip(loops, ("#D55E00", "#0072B2", "#009E73"), strict=True))

    def draw(row: int, values: FloatArray, name: str, shown: bool) -> None:
        style = {"color": colours[name]}
        figure.add_scatter(
            x=time, y=values, row=row, col=1, name=name, line=style, legendgroup=name, showlegend=shown and row % 3 == 0
        )

    for joint in range(3):
        draw(3 + joint, wanted[joint], "reference", True)
        draw(3 + joint, true.position[every, joint], "true arm", True)
        draw(6 + joint, true.position[every, joint] - wanted[joint], "true arm", False)
        draw(12 + joint, true.torque[every, joint], "true arm", False)
        for name, motion in loops.items():
            draw(9 + joint, motion.position[every, joint] - true.position[every, joint], name, True)
            draw(12 + joint, motion.torque[every, joint], name, False)
    figure.update_layout(height=280 * len(titles), hovermode="x unified", title="UP6 by SFLA", legend={"y": 0.8})
    assert isinstance(figure, go.Figure)
    figure.write_html(folder / "figures.html", include_plotlyjs=True)
    run = dynid.Recording.from_arrays("up6", time=true.time, position=true.position, torque=true.torque)
    for method in ("sfla", "wls"):
        dynid.identify(run, method=method, delay=0.0).save(folder / method)
    print(f"\n{folder}/figures.html, {folder}/sfla/report.html, {folder}/wls/report.html")


def main() -> None:
    true = closed_loop(BASE.projection @ TRUTH)
    error = true.position - PAPER.evaluate(true.time)[0].T
    print(f"closed loop: RMS position error {np.sqrt(np.mean(error**2, axis=0))} rad")
    loops, history = tables(Problem.of(true), true)
    if len(sys.argv) == 3 and sys.argv[1] == "--page":
        page(Path(sys.argv[2]), true, loops, history)


if __name__ == "__main__":
    main()
