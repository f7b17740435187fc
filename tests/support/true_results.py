"""Results as an identification would write them, of arms whose parameters are known."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from daq.robot.loader import RobotFile
from drivers.core.arrays import FloatArray
from ident.assessment.delay.delay import DelaySearch
from ident.identify.summary import gain_results, model_options
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import build_model
from ident.model.true_parameters import truth_vector
from ident.result.delivered import Delivered
from ident.result.estimate import EstimateResult
from ident.result.schema import BaseParameterResult, Essential, Excitation, Residuals, Result
from ident.result.units import parameter_unit
from ident.verdict.verdict import Verdict


def truth_of(robot_file: RobotFile) -> FloatArray:
    """True base parameters (b,) of a simulated arm."""
    return base_parameters(build_model(robot_file)).projection @ truth_vector(robot_file)


def true_result(
    robot_file: RobotFile, values: Mapping[str, float | None] | None = None, covariance: FloatArray | None = None
) -> Result:
    """The result of an identification without error.

    Args:
        robot_file: with a truth.
        values: base parameters that differ from the truth; None has no value.
        covariance: (b, b) of the base parameters that have a value.
    """
    model = build_model(robot_file)
    base = base_parameters(model)
    truth = dict(zip(base.names, (base.projection @ truth_vector(robot_file)).tolist(), strict=True))
    known: dict[str, float | None] = {**truth, **(values or {})}
    estimated = [name for name in base.names if known[name] is not None]
    estimate = None
    if covariance is not None:
        root = np.linalg.qr(np.linalg.inv(np.linalg.cholesky(covariance)), mode="r")
        estimate = EstimateResult(
            parameters=estimated, root=root.tolist(), covariance=covariance.tolist(), absorbed={}, blocks=20
        )
    return Result(
        created="2026-11-22T00:00:00+00:00",
        robot=robot_file.robot.name,
        robot_file=robot_file.text,
        urdf=robot_file.urdf_text or "",
        joints=list(robot_file.robot.joint_names),
        method="truth",
        options={},
        model_options=model_options(model),
        preprocessing=[],
        delay=DelaySearch(used=0.0, note=""),
        base_parameters=[
            BaseParameterResult(
                name=name,
                expression=base.expressions[i],
                kind=base.kinds[i],
                joint=model.link_names[base.joints[i]],
                unit=parameter_unit(model, base.columns[i]),
                value=known[name],
                std=None,
                rsd_percent=None,
                classical_std=None,
                significant=True,
                essential_value=known[name],
                essential_std=None,
            )
            for i, name in enumerate(base.names)
        ],
        friction=[],
        drive_gains=gain_results(robot_file.robot, robot_file.robot.joint_names),
        fit=None,
        validation=None,
        validation_source="",
        delivered=Delivered(parameters="full"),
        essential=Essential(count=len(estimated), dropped=[], stopped_by="", fit=None, validation=None),
        excitation=Excitation(condition=1.0, scaled_condition=1.0, singular_values=[], unexcited=[]),
        condition=1.0,
        residuals=Residuals(
            rows=0,
            effective_rows=None,
            joint_std=[None] * model.dof,
            autocorrelation=[None] * model.dof,
            block_length=0,
            blocks=0,
            repetitions=1.0,
            correction="",
        ),
        rank_margin=base.margin,
        recordings=[],
        versions={},
        verdict=Verdict("true parameters"),
        estimate=estimate,
    )
