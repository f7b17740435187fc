"""Is what a robot file states of bodies and joints named where it is wrong, and only there? Simulated arms.

For each kind of value, one value per arm, drawn by chance: how often it is named or refused as it is, times 30, times
1,000 and by 1/100; in brackets how often because the data deny it. A value of 0 is left out; so are first and second
moments by 1/100, which any body may have.

    python -m studies.checks.stated_values [ARMS]

ARMS arms of each kind (built as arms are, the same with link-side sensors, with random frames, further ones).
"""

from __future__ import annotations

import os
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.append(str(Path(__file__).parents[2] / "tests" / "support"))

import numpy as np
from random_arms import built_arm

from daq.robot.loader import RobotFile
from daq.robot.prior import Known
from drivers.core.errors import RobotFileError
from ident.estimators.feasible.consistent import found_consistent
from ident.identify.checks.stated_values import stated_value_checks
from ident.identify.identification import Identification, IdentifyChoices, ModelChoices
from ident.identify.identify import identify
from ident.model.true_parameters import true_model, truth_vector
from studies.checks.random_mistakes import arm, further_arm, recorded

FACTORS = (1.0, 30.0, 1000.0, 0.01)
CHOICES = IdentifyChoices(search_delay=False, presliding=False, model=ModelChoices(friction="coulomb-viscous"))


def arms(count: int) -> Iterator[RobotFile]:
    """Arms of all kinds."""
    for seed in range(7500, 7500 + count):
        yield from (built_arm(seed), built_arm(seed, link_side=True), arm(seed), further_arm(seed))


def named(found: Identification, key: str, value: float) -> tuple[bool, bool]:
    """Return whether a known value is named or refused, and whether that is because the data deny it."""
    robot = found.robot_file.robot.model_copy(update={"known": {key: Known(value=value)}})
    file = found.robot_file.model_copy(update={"robot": robot})
    try:
        bodies = found_consistent(found.model, found.base, found.estimate, file)
    except RobotFileError:
        return True, True
    denied = () if bodies is None else bodies.contradicted
    return bool(denied or stated_value_checks(found.model, file, found.base, found.estimate, denied)), bool(denied)


def kind_of(key: str) -> str:
    """The row of a value."""
    if key == "total_mass":
        return "total mass"
    moments = "first moment" if key[0] == "M" else "second moment" if key[0] in "XYZ" else ""
    symbol = key.rstrip("0123456789")
    return "mass of a link" if symbol == "M" else moments or {"Ia": "motor inertia"}.get(symbol, "friction")


def main(count: int) -> None:
    """Print the table."""
    tried, seen, denied = (Counter[tuple[str, float]]() for _ in range(3))
    for number, file in enumerate(arms(count)):
        found = identify([recorded(file, number)], [], CHOICES)
        if found.consistent is None:
            continue
        model, own = true_model(file), {parameter.name for parameter in found.model.parameters}
        true = dict(zip([parameter.name for parameter in model.parameters], truth_vector(file, model), strict=True))
        true["total_mass"] = sum(true[f"M{link + 1}"] for link in range(len(model.joints)))
        generator = np.random.default_rng(number)
        by_kind: dict[str, list[str]] = {}
        for key, value in true.items():
            if value and (key in own or key == "total_mass"):
                by_kind.setdefault(kind_of(key), []).append(key)
        for kind, keys in by_kind.items():
            key = str(generator.choice(keys))
            for factor in FACTORS[: 3 if "moment" in kind else 4]:
                tried[kind, factor] += 1
                said, by_data = named(found, key, factor * float(true[key]))
                seen[kind, factor] += said
                denied[kind, factor] += by_data
    print("| named or refused | as it is | times 30 | times 1,000 | by 1/100 |\n|---|---|---|---|---|")
    for kind in dict.fromkeys(kind for kind, _ in tried):
        cells = [f"{seen[kind, f]} ({denied[kind, f]}) of {tried[kind, f]}" if tried[kind, f] else "–" for f in FACTORS]
        print(f"| {kind} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 8)
