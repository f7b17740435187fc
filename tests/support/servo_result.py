"""A servo model whose parameters are a simulated arm's truth, without an identification."""

from __future__ import annotations

from daq.robot.loader import RobotFile
from ident.result.graded import Grade
from ident.servo.result import References, RolloutFit, ServoJoint, ServoParameter, ServoResult
from ident.servo.terms import INDEX, TERMS
from studies.synthetic.altered_arms import true_values


def true_servo_result(file: RobotFile, sigma: float = 0.05) -> ServoResult:
    """The result that a perfect identification would give.

    Args:
        file: its truth has a servo for every joint.
        sigma: standard deviation of every logarithm, and of other terms in their unit times 0.01.
    """
    joints, searched, covariance = [], [], []
    for joint, terms in true_values(file).items():
        parameters = {}
        for name, value in terms.items():
            term = TERMS[INDEX[name]]
            if term.positive and (value <= 1e-9 or value >= 1e6 or value == term.absent):
                continue
            own = sigma if term.positive else 0.01 * sigma
            ends = (value * (1 - 1.96 * own), value * (1 + 1.96 * own)) if term.positive else (value - own, value + own)
            parameters[name] = ServoParameter(value=value, unit=term.unit, interval=ends)
        joints.append(ServoJoint(joint=joint, parameters=parameters))
        searched.append(list(parameters))
        scales = [sigma if TERMS[INDEX[name]].positive else 0.01 * sigma for name in parameters]
        covariance.append(
            [
                [a * b * (1.0 if row == column else 0.5) for column, b in enumerate(scales)]
                for row, a in enumerate(scales)
            ]
        )
    names = list(file.robot.joint_names)
    nothing = [0.001] * len(names)
    fit = RolloutFit(
        rollout_error=nothing,
        rollout_mean=0.001,
        references=References(command=nothing, delay_and_lag=nothing),
        recordings=[],
        held_out=True,
        seconds=1.0,
    )
    return ServoResult(
        created="2026-01-01T00:00:00+00:00",
        robot=file.robot.name,
        robot_file=file.text,
        urdf=file.urdf_text or "",
        joints=names,
        sliding=[False] * len(names),
        links="the URDF",
        resolution=[file.robot.truth.noise.encoder_resolution or 1e-4] * len(names),
        step=0.005,
        servo=joints,
        covariance=covariance,
        searched=searched,
        fit=fit,
        validation=fit,
        validation_source="nothing",
        recordings=[],
        versions={},
        verdict=Grade(grade="good", headline="Good."),
    )
