"""What `dynid excite` has after a time, for every built-in arm: `python -m studies.excitation.excite_robots 60 [BUSY]`.

Each arm is designed for in a separate process, for so many seconds, by default options. Prints the process time
until the first feasible motion (Python's start and imports included), the criterion (d-optimal) of that motion and of
the best after 5 s, 20 s and at the end, the expected worst error bar of the first and the last, what the design took by
the wall clock, and the load average. BUSY processes that never rest run beside it.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from daq.robot.loader import builtin_robots
from ident.excite.search.search import SearchResult
from ident.tasks.excitation import design_excitation

MARKS = (5.0, 20.0)
BUSY = "while True: pass"


def measure(name: str, seconds: float) -> None:
    """Print the line of an arm."""
    first: list[float] = []
    begun = time.monotonic()
    seen: list[tuple[float, float, float]] = []

    def look(state: SearchResult) -> None:
        if state.best is None:
            return
        if not first:
            first.append(time.process_time())
        worst = np.nan if state.best.worst is None else state.best.worst.percent
        seen.append((state.seconds, float(np.exp(state.best.cost)), worst))

    trajectory = design_excitation(name, time=seconds, progress=look)
    taken = time.monotonic() - begun
    assert trajectory.design is not None
    costs = [seen[0][1], *(min(cost for at, cost, _ in seen if at <= mark) for mark in MARKS if mark < seconds)]
    costs.append(trajectory.design.cost)
    print(
        f"{name:9} {first[0]:6.2f} {''.join(f'{cost:10.4g}' for cost in costs)} {seen[0][2]:8.0f} {seen[-1][2]:8.1f}"
        f" {taken:7.2f} {os.getloadavg()[0]:6.1f} {trajectory.design.search.finished:4d}",
        flush=True,
    )


def main(seconds: float, busy: int) -> None:
    """A line for each arm, each from a separate process."""
    marks = "".join(f"{f'{mark:g} s':>10}" for mark in MARKS if mark < seconds)
    print(
        f"{'arm':9} {'CPU s':>6} {'first':>10}{marks}{f'{seconds:g} s':>10} {'±% first':>8} {'±% last':>8} "
        f"{'wall s':>7} {'load':>6} starts"
    )
    others = [subprocess.Popen([sys.executable, "-c", BUSY]) for _ in range(busy)]
    try:
        for name in builtin_robots():
            subprocess.run(
                [sys.executable, "-m", "studies.excitation.excite_robots", f"{seconds:g}", "0", name], check=True
            )
    finally:
        for other in others:
            other.kill()


if __name__ == "__main__":
    arguments = sys.argv[1:]
    if len(arguments) == 3:
        measure(arguments[2], float(arguments[0]))
    else:
        main(float(arguments[0]) if arguments else 60.0, int(arguments[1]) if len(arguments) > 1 else 0)
