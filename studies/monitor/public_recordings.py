"""Forces added to public recordings of real arms: how many of them are noticed? About 2 min of processor time.

    python -m studies.monitor.public_recordings [DATA]

DATA is the folder of the public recordings (`DYNID_DATA`). The model and the thresholds (one false alarm per hour) come
from the first 70 % of each recording; in the rest, which neither has seen, false alarms are counted, and forces of
multiples of the stated smallest one added, to each link in six directions.
"""

from __future__ import annotations

import os
import sys
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from drivers.core.errors import DataError
from ident.identify.identify import identify
from ident.monitor.monitor import Monitor, earned_thresholds, joint_samples
from ident.result.models.model import Model
from studies.models.consistency import public
from studies.monitor.contacts import WITHIN, delays, pushed, rows

ARMS = {"ur10": 50.0, "panda": 100.0, "tx40": 200.0}
"""Bandwidth of the observer [1/s]: a short recording has more independent residuals of a faster one."""
LEARNT = 0.7
REPEATS = 6


def main() -> None:
    """Print the table."""
    data = Path(sys.argv[1] if len(sys.argv) > 1 else os.environ.get("DYNID_DATA", "../shared/data"))
    print(
        "| arm | seconds learnt on | watched | false alarms there | pushes | found at the stated force [%] | at twice "
        "[%] | within 30 ms [%] | median delay [ms] |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    for name, bandwidth in ARMS.items():
        recording, choices = public(data, name)
        found = identify([recording], [], replace(choices, model=replace(choices.model, friction=None)))
        model = Model(found.result)
        samples = joint_samples(model, recording)
        cut = int(np.searchsorted(samples.time, samples.time[0] + LEARNT * (samples.time[-1] - samples.time[0])))
        known, rest = rows(samples, slice(0, cut)), rows(samples, slice(cut, None))
        try:
            thresholds = earned_thresholds(model, [(name, known)], kind="direct", bandwidth=bandwidth)
        except DataError as error:
            print(f"| {name} | {error} | | | | | | | |", flush=True)
            continue
        quiet = Monitor(model, thresholds, load=False)
        quiet.add(rest)
        late: dict[float, list[float]] = {1.0: [], 2.0: []}
        for multiple, delay in late.items():
            generator = np.random.default_rng(1)
            for _ in range(REPEATS):
                with_force, contacts = pushed(model, rest, thresholds, multiple, generator)
                delay += delays(model, with_force, thresholds, [contact for _, contact in contacts]).tolist()
        single, double = (np.array(values) for values in late.values())
        print(
            f"| {name} | {known.time[-1] - known.time[0]:.0f} | {rest.time[-1] - rest.time[0]:.0f} | "
            f"{len(quiet.contacts)} | {len(double)} | {100 * np.mean(np.isfinite(single)):.0f} | "
            f"{100 * np.mean(np.isfinite(double)):.0f} | {100 * np.mean(double <= WITHIN):.0f} | "
            f"{1e3 * np.median(double):.0f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
