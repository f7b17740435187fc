"""Excitations for every built-in arm, with all limits: `python studies/excite_robots.py 30` gives each 30 s.

Friction columns included, rest to rest, torque limits from the file's truth, self-collision. Prints the condition
number of the base regressor (columns scaled), how long it took, how often, and the largest use of any limit on a grid
ten times denser than the design's.
"""

from __future__ import annotations

import os
import sys

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from daq.robot.loader import builtin_robots, load_robot
from ident.excite.choices import DesignChoices
from ident.excite.design import design
from ident.excite.prior import find_prior
from ident.excite.search.search import SearchChoices


def main(seconds: float) -> None:
    """Print a line for each arm."""
    print(f"{'arm':10} {'condition':>10} {'starts':>7} {'seconds':>8} {'largest use':>12}  of")
    for name in builtin_robots():
        robot_file = load_robot(name)
        found = design(
            robot_file,
            find_prior(robot_file),
            DesignChoices(criterion="condition", margin=0.01),
            SearchChoices(starts=None, seconds=seconds),
        )
        worst = int(found.use.argmax())
        print(
            f"{name:10} {found.cost:10.2f} {found.search.finished:7d} {found.search.seconds:8.1f} "
            f"{100 * found.use[worst]:11.2f} %  {found.limits[worst]}",
            flush=True,
        )


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 30.0)
