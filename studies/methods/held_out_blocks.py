"""Which of dynid's parameters predict best, by blocks of a benchmark's training data alone: its test part is not read.

    python -m studies.methods.held_out_blocks DATASET [BLOCKS]

Each block of the training recording is predicted by models of the others: what dynid delivers, its unconstrained
parameters, and plain least squares. A CPU minute per block.
"""

from __future__ import annotations

import os
import sys
from itertools import pairwise
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from ident.benchmark.dataset import load_dataset, part, registered
from ident.benchmark.entries.dynid_model import predictor_of
from ident.benchmark.entries.plain_regression import pinocchio_lstsq
from ident.benchmark.entry import Training
from ident.benchmark.judge import judge_torques
from ident.benchmark.motion import motions
from ident.tasks.identification import identify

SHORTEST = 3.0
"""[s] of a training part: a shorter one is left out."""


def main() -> None:
    """Print a row per block, and the root mean square over the blocks."""
    name, blocks = sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 3
    dataset = registered()[name]
    data = load_dataset(dataset, Path(os.environ.get("DYNID_DATA", "../shared/data")))
    (whole,) = data.train
    edges = np.linspace(0.0, float(np.ptp(whole.time)) + 1e-3, blocks + 1).tolist()
    judged = dataset.rate, dataset.states, dataset.band
    print("| block | delivered [%] | unconstrained [%] | plain least squares [%] |\n|---|---|---|---|")
    squares = []
    for number, (start, stop) in enumerate(pairwise(edges), 1):
        sides = ((0.0, start), (stop, edges[-1]))
        others = tuple(part(whole, *side) for side in sides if side[1] - side[0] > SHORTEST)
        own = part(whole, start, stop)
        states = [motion for other in others for motion in motions(other, data.robot, *judged)]
        training = Training(data.robot, others, tuple(states))
        ours = identify(others, validation=[own], robot=data.robot)
        predictors = (predictor_of(ours, "consistent"), predictor_of(ours, "full"), pinocchio_lstsq(training))
        held_out = motions(own, data.robot, *judged)
        errors = [judge_torques(predictor, held_out, data.robot).relative_error for predictor in predictors]
        squares.append(np.square(errors))
        print(f"| {number} | {' | '.join(f'{error:.2f}' for error in errors)} |", flush=True)
    print(f"| all | {' | '.join(f'{error:.2f}' for error in np.sqrt(np.mean(squares, axis=0)))} |")


if __name__ == "__main__":
    main()
