"""Are trends and steps of histories honest? `python -m studies.history.history 500` takes four CPU minutes.

Simulated histories of one parameter, whose value falls exponentially with a temperature that follows the season, the
use of the arm and chance; results have a σ of 1 % that differs by 30 %, and scatter by 2 % between results: at random,
or alike over a part of the history (an Ornstein-Uhlenbeck process). Prints in how many of so many histories the true
change lies in its 95 % interval, the median half width of that, and how often a change or step is found; and, of arms
with twelve parameters none of which changes, how many have any finding.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from ident.history.arm import arm_history
from ident.history.entry import HistoryEntry

sys.path.append(str(Path(__file__).parents[2] / "tests" / "support"))
from arm_histories import worn_arm

CASES = (
    ("200 results, rise of 12 %", 200, 0.12, 0.0, 0.0),
    ("200 results, no change", 200, 0.0, 0.0, 0.0),
    ("200 results, alike over 5 % of the time, rise of 12 %", 200, 0.12, 0.0, 0.05),
    ("200 results, alike over 15 % of the time, rise of 12 %", 200, 0.12, 0.0, 0.15),
    ("200 results, step of 5 %", 200, 0.0, 0.05, 0.0),
    ("200 results, step of 10 %", 200, 0.0, 0.1, 0.0),
    ("30 results, rise of 12 %", 30, 0.12, 0.0, 0.0),
    ("30 results, no change", 30, 0.0, 0.0, 0.0),
    ("30 results, alike over 10 % of the time, no change", 30, 0.0, 0.0, 0.1),
    ("8 results, rise of 12 %", 8, 0.12, 0.0, 0.0),
)
"""Name, results, rise, step, and for how long results are alike, relative to the history."""


def history(seed: int, count: int, rise: float, step: float, alike: float) -> list[HistoryEntry]:
    """Results of an arm, whose scatter may last."""
    if alike == 0.0:
        return worn_arm(seed, count, {"Fs1": rise}, step=step)
    entries = worn_arm(seed, count, {"Fs1": rise}, step=step, scatter=0.0)
    time = np.array([entry.time for entry in entries])
    apart = np.abs(time[:, None] - time) / (time[-1] - time[0])
    root = np.linalg.cholesky(np.exp(-apart / alike) + 1e-9 * np.eye(count))
    added = 0.02 * root @ np.random.default_rng(seed + 10_000).normal(size=count)
    return [
        replace(entry, values=tuple(replace(value, value=value.value + float(more)) for value in entry.values))
        for entry, more in zip(entries, added, strict=True)
    ]


def main(histories: int) -> None:
    """Print the table."""
    print("| histories | true change inside [%] | half width [%] | change found [%] | step found [%] |")
    print("|---|---:|---:|---:|---:|")
    for name, count, rise, step, alike in CASES:
        found = [arm_history("a", history(seed, count, rise, step, alike)).parameters[0] for seed in range(histories)]
        trends = [one.trend for one in found if one.trend is not None]
        inside = np.mean([abs(trend.change - rise - step) <= trend.change_half for trend in trends])
        half = np.median([trend.change_half / trend.start for trend in trends])
        changed, stepped = np.mean([one.significant for one in found]), np.mean([bool(one.steps) for one in trends])
        print(f"| {name} | {100 * inside:.0f} | {100 * half:.1f} | {100 * changed:.0f} | {100 * stepped:.0f} |")
    names = [f"Fs{number}" for number in range(1, 10)] + ["Fv1", "Fv2", "Fv3"]
    arms = [arm_history("a", worn_arm(seed, 40, dict.fromkeys(names, 0.0))) for seed in range(histories)]
    share = np.mean([bool(arm.findings) for arm in arms])
    print(f"\n| arms | any finding [%] |\n|---|---:|\n| 12 parameters, 40 results, no change | {100 * share:.1f} |")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 200)
