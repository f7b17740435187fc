"""Declared limits: what is read of a file, what passes, what fails and why."""

from __future__ import annotations

from dataclasses import replace

import pytest
from each import each
from hypothesis import given
from hypothesis import strategies as st

from drivers.core.errors import UsageError
from ident.verdict.acceptance import (
    AcceptanceLimits,
    ModelFigures,
    check_joints,
    declared,
    judge_acceptance,
    read_limits,
)
from ident.verdict.verdict import PurposeVerdict, Verdict

FIGURES = ModelFigures(
    model="consistent",
    relative_error=0.05,
    joint_relative_error={"a": 0.1, "b": 0.2},
    rmse={"a": 1.0, "b": None},
    motion_rmse={"a": 0.01, "b": float("nan")},
    sliding={},
    consistent=True,
    consistency_cost=1.1,
    verdict=Verdict("", {"simulation": PurposeVerdict("usable", "few equations")}),
)


def failed(**limits) -> list[tuple[str, str]]:
    """Limit and subject of what failed."""
    acceptance = judge_acceptance(declared(limits, "limits"), FIGURES)
    assert acceptance.passed == all(criterion.passed for criterion in acceptance.criteria)
    return [(criterion.name, criterion.subject) for criterion in acceptance.criteria if not criterion.passed]


@each(
    ("limits", "expected"),
    [
        ({"relative_error": 0.05}, []),
        ({"relative_error": 0.0499}, [("relative_error", "")]),
        ({"joint_relative_error": 0.15}, [("joint_relative_error", "b")]),
        ({"joint_relative_error": {"a": 0.15}}, []),
        ({"rmse": 2.0}, [("rmse", "b")]),  # not known
        ({"rmse": {"a": 1.0}}, []),
        ({"motion_rmse": 0.02}, [("motion_rmse", "b")]),
        ({"consistent": True, "consistency_cost": 1.2}, []),
        ({"consistency_cost": 1.05}, [("consistency_cost", "")]),
        ({"purposes": {"simulation": "usable"}}, []),
        ({"purposes": {"simulation": "good"}}, [("purposes", "simulation")]),
        ({"purposes": {"payload_estimation": "poor"}}, [("purposes", "payload_estimation")]),  # not judged
        ({"relative_error": 0.01, "rmse": 0.5}, [("relative_error", ""), ("rmse", "a"), ("rmse", "b")]),
    ],
)
def test_what_fails(limits, expected):
    assert failed(**limits) == expected


def test_without_a_consistent_model_its_limits_fail():
    lacking = replace(FIGURES, consistent=False, consistency_cost=None)
    acceptance = judge_acceptance(AcceptanceLimits(consistent=True, consistency_cost=2.0), lacking)
    assert [criterion.passed for criterion in acceptance.criteria] == [False, False]
    assert "FAILED: 0 of 2" in str(acceptance)
    assert "is unknown" in str(acceptance)


@given(limit=st.floats(1e-6, 1.0), value=st.floats(0.0, 2.0))
def test_a_value_passes_up_to_its_limit(limit, value):
    figures = replace(FIGURES, relative_error=value)
    assert judge_acceptance(AcceptanceLimits(relative_error=limit), figures).passed == (value <= limit)


@each(
    ("text", "message"),
    [
        ("relative_error: 8", "8 is a ratio, not a percentage"),
        ("joint_relative_error: {a: 20}", "20 is a ratio"),
        ("relative_error: -1", "relative_error.*greater than 0"),
        ("rmse: {a: true}", "rmse: found True for a"),
        ("rmse: [1]", r"rmse: found \[1\], but a limit is a number"),
        ("rmse: .nan", "rmse: found nan"),
        ("rmsee: 1", "did you mean 'rmse'"),
        ("purposes: {simulation: best}", "found 'best'"),
        ("purposes: {cooking: good}", "found 'cooking'"),
        ("consistent: false", "requires nothing"),
        ("{}", "states no limit"),
        ("", "a file of limits is a mapping"),
        ("rmse: 1\nrmse: 2", "rmse"),
        ("a: [", "not valid YAML"),
    ],
)
def test_wrong_files_are_refused_in_one_line(tmp_path, text, message):
    (tmp_path / "limits.yaml").write_text(text)
    with pytest.raises(UsageError, match=message) as refused:
        read_limits(tmp_path / "limits.yaml")
    assert "limits.yaml" in str(refused.value)
    assert "\n" not in str(refused.value)


def test_files_that_cannot_be_read_are_refused(tmp_path):
    with pytest.raises(UsageError, match="no such file"):
        read_limits(tmp_path / "nowhere.yaml")
    with pytest.raises(UsageError, match="is a folder, not a file"):
        read_limits(tmp_path)
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(UsageError, match="not UTF-8"):
        read_limits(tmp_path / "binary.yaml")


def test_limits_of_unknown_joints_are_refused():
    limits = declared({"rmse": {"elbow": 1.0}, "motion_rmse": {"a": 1.0}}, "limits")
    with pytest.raises(UsageError, match=r"limits for elbow, which the robot does not have \(joints: a, b\)"):
        check_joints(limits, ["a", "b"])
