"""A load that can exist, as it is stored and as it is said."""

from __future__ import annotations

from typing import Any

import numpy as np

from drivers.core.text import percent_text
from ident.estimators.feasible.pseudo_inertia import Body, body_of
from ident.experiments.load.consistent_load import ConsistentLoad
from ident.experiments.run_pair import RunPair
from ident.experiments.schema import ConsistentLoadResult, LinkBody, RunError
from ident.model.parameters import INERTIAL

INERTIA = ("xx", "xy", "xz", "yy", "yz", "zz")
"""Elements of an inertia, in the order of the ten standard parameters."""


def consistent_load_result(pair: RunPair, load: ConsistentLoad) -> ConsistentLoadResult:
    """The load that can exist, and the arm with it."""
    names = pair.model.link_names
    links = load.loaded_arm.reshape(len(names), len(INERTIAL))
    errors = zip(pair.runs, load.errors, load.consistent_errors, strict=True)
    return ConsistentLoadResult(
        **_body(load.body),
        mass_std=load.mass_std,
        com_std=load.com_std.tolist(),
        inertia_std=dict(zip(INERTIA, load.inertia_std.tolist(), strict=True)),
        determined={f"{symbol}_L": float(share) for symbol, share in zip(INERTIAL, load.determined, strict=True)},
        held=[f"{symbol}_L" for symbol, known in zip(INERTIAL, load.known, strict=True) if known],
        on_boundary=load.on_boundary,
        boundary_links=[names[link] for link in load.boundary],
        cost=load.test,
        errors=[RunError(run=run.label, unconstrained=error, consistent=own) for run, error, own in errors],
        links=[LinkBody(link=name, **_body(body_of(link))) for name, link in zip(names, links, strict=True)],
    )


def _body(body: Body) -> dict[str, Any]:
    inertia = dict(zip(INERTIA, body.inertia[np.triu_indices(3)].tolist(), strict=True))
    return {"mass": body.mass, "com": body.com.tolist(), "inertia": inertia}


def consistent_load_sentences(load: ConsistentLoadResult) -> list[str]:
    """What it costs that load and links can exist."""
    errors = "; ".join(
        f"{error.run}: {percent_text(error.unconstrained)} unconstrained, {percent_text(error.consistent)} consistent"
        for error in load.errors
    )
    sentences = [f"relative error of the torque: {errors}"]
    if load.cost is not None:
        cost = load.cost
        verdict = "explains the runs as well" if cost.passed else "does not explain the runs as well"
        sentences.append(
            f"a load that can exist, on links that can exist, {verdict} as the unconstrained estimate (χ² = "
            f"{cost.statistic:.1f} with {cost.freedom} degrees of freedom, {cost.p_text})"
        )
    held = ["the load"] * load.on_boundary + load.boundary_links
    if held:
        sentences.append(f"at the boundary of what can exist: {', '.join(held)}")
    return sentences
