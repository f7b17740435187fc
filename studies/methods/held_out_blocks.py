"""Which of dynid's parameters predict best, by blocks of benchmarks' training data alone: their test part is not read.

    python -m studies.methods.held_out_blocks DATASETS [BLOCKS]

Each block of a training recording is predicted by models of the others: what dynid delivers by default and with one
option changed, the default's unconstrained parameters, and plain least squares. Half a CPU minute per block.
"""

from __future__ import annotations

import os
import sys
from itertools import pairwise
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from ident.benchmark.dataset import Dataset, LoadedData, load_dataset, part, registered
from ident.benchmark.entries.dynid_model import predictor_of
from ident.benchmark.entries.plain_regression import pinocchio_lstsq
from ident.benchmark.entry import Training
from ident.benchmark.judge import judge_torques
from ident.benchmark.motion import motions
from ident.tasks.identification import identify

SHORTEST = 3.0
"""[s] of a training part: a shorter one is left out."""


OPTIONS: dict[str, dict[str, Any]] = {
    "default": {},
    "without presliding": {"presliding": False},
    "friction `coulomb-viscous`": {"friction": "coulomb-viscous"},
    "`ols`": {"method": "ols"},
    "`irls`": {"method": "irls"},
}


def errors(dataset: Dataset, data: LoadedData, start: float, stop: float) -> list[float]:
    """Relative errors [%] of each model on the block from `start` to `stop` [s]."""
    (whole,) = data.train
    judged = dataset.rate, dataset.states, dataset.band
    sides = ((0.0, start), (stop, float(np.ptp(whole.time)) + 1e-3))
    others = tuple(part(whole, *side) for side in sides if side[1] - side[0] > SHORTEST)
    own = part(whole, start, stop)
    states = [motion for other in others for motion in motions(other, data.robot, *judged)]
    ours = [identify(others, validation=[own], robot=data.robot, **options) for options in OPTIONS.values()]
    plain = pinocchio_lstsq(Training(data.robot, others, tuple(states)))
    predictors = [*(predictor_of(one, "consistent") for one in ours), predictor_of(ours[0], "full"), plain]
    held_out = motions(own, data.robot, *judged)
    return [judge_torques(predictor, held_out, data.robot).relative_error for predictor in predictors]


def main() -> None:
    """Print a row per block, and the root mean square over the blocks of each data set."""
    names, blocks = sys.argv[1].split(","), int(sys.argv[2]) if len(sys.argv) > 2 else 3
    heads = ["data set", "block", *OPTIONS, "unconstrained", "plain least squares"]
    print(f"| {' | '.join(heads)} |\n|{'---|' * len(heads)}")
    for name in names:
        dataset = registered()[name]
        data = load_dataset(dataset, Path(os.environ.get("DYNID_DATA", "../shared/data")))
        edges = np.linspace(0.0, float(np.ptp(data.train[0].time)) + 1e-3, blocks + 1).tolist()
        rows = {str(n): errors(dataset, data, *edge) for n, edge in enumerate(pairwise(edges), 1)}
        rows["all"] = np.sqrt(np.mean(np.square(list(rows.values())), axis=0)).tolist()
        for label, row in rows.items():
            print(f"| {name} | {label} | {' | '.join(f'{error:.2f}' for error in row)} |", flush=True)


if __name__ == "__main__":
    main()
