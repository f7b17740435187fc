"""A motor's own parameters among columns, and the load torque that estimated parameters say."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from drivers.core.arrays import FloatArray
from ident.friction.terms import FrictionTerms, LoadTorque
from ident.model.base_parameters import BaseParameters
from ident.model.dynamic_model import DynamicModel
from ident.model.regressor import LoadTorqueKernel
from ident.signals.prepared import Prepared


def own_column(model: DynamicModel, columns: Sequence[int], kind: str, motor: int) -> int | None:
    """Place among standard `columns` of a motor's own parameter of a kind; None where it is not among them."""
    standard, joint = model.parameters, model.active[motor]
    places = (
        place
        for place, column in enumerate(columns)
        if standard[column].kind == kind and standard[column].joint == joint
    )
    return next(places, None)


def gravity_of(base: BaseParameters, parameters: FloatArray) -> LoadTorque:
    """Return what the links' parameters among base parameters (b,) say of gravity (AUBO eq. 18)."""
    links = [place for place, kind in enumerate(base.kinds) if kind == "inertial"]
    return LoadTorque(tuple(base.columns[place] for place in links), tuple(parameters[links].tolist()))


def load_change(model: DynamicModel, runs: Sequence[Prepared], before: FrictionTerms, after: FrictionTerms) -> float:
    """Largest change of a motor's load torque over the data's largest one of any motor."""
    if before.load_torque is None:
        return float("inf")
    old, new = (LoadTorqueKernel(replace(model, terms=terms)) for terms in (before, after))
    change, size = 0.0, float(np.finfo(np.float64).tiny)
    for run in runs:
        for segment in run.segments:
            position = segment.position[:, :: run.parallel_filter.factor]
            torque = new.torque(position)
            change = max(change, float(np.max(np.abs(torque - old.torque(position)))))
            size = max(size, float(np.max(np.abs(torque))))
    return change / size
