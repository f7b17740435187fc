"""The verdict follows from the checks and the errors, and cannot contradict them."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path

from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import TypeAdapter

from ident.assessment.validation import LOW_SPEED
from ident.verdict.catalogue import CATALOGUE, raised
from ident.verdict.check import PURPOSE_WORDS, PURPOSES, Check
from ident.verdict.evidence import Evidence, MotionError, TorqueError
from ident.verdict.verdict import AT_BEST, GRADES, Verdict, judge, together
from studies.checks.checks_table import markdown_lists

JOINTS = ("j1", "j2", "j3")
DOCS = Path(__file__).parents[3] / "docs" / "checks.md"

ratios = st.none() | st.floats(0.0, 2.0) | st.just(float("nan"))
torques = st.builds(TorqueError, ratios, ratios, ratios)
of_joints = st.fixed_dictionaries(dict.fromkeys(JOINTS, st.floats(0.0, 5.0)))
motions = st.builds(MotionError, st.floats(0.0, 5.0), of_joints, of_joints, st.just("simulated motion"))
errors = st.none() | st.builds(
    Evidence, torques, st.fixed_dictionaries(dict.fromkeys(JOINTS, torques)), st.lists(motions, max_size=2).map(tuple)
)
checks = st.lists(
    st.builds(
        raised, st.sampled_from(sorted(CATALOGUE)), st.text(min_size=1, max_size=5), st.lists(st.sampled_from(JOINTS))
    ),
    max_size=6,
)


def badness(grade: str) -> int:
    return GRADES.index(grade)  # type: ignore[arg-type]


def evidence(whole: float | None, joints: dict[str, float], motion: float | None = 0.1) -> Evidence:
    """One figure for all samples and in motion; each joint simulated alike."""
    simulated = [] if motion is None else [motion]
    return Evidence(
        TorqueError(whole, whole),
        {joint: TorqueError(error, error) for joint, error in joints.items()},
        tuple(
            MotionError(one, dict.fromkeys(joints, one), dict.fromkeys(joints, f"{one:g} rad"), "motion")
            for one in simulated
        ),
    )


def grades(verdict: Verdict) -> dict[str, int]:
    """How bad every purpose and every joint is."""
    return {name: badness(one.grade) for name, one in verdict.purposes.items()} | {
        one.joint: badness(one.grade) for one in verdict.joints
    }


@settings(max_examples=50)
@given(checks, checks, errors)
def test_more_checks_never_improve_anything(some: list[Check], more: list[Check], known: Evidence | None) -> None:
    before, after = grades(judge(some, known)), grades(judge([*some, *more], known))
    assert all(after[name] >= before[name] for name in before)


@given(checks, errors)
def test_what_a_check_spoils_is_no_better_than_its_severity_allows(some: list[Check], known: Evidence | None) -> None:
    verdict = judge(some, known)
    for check in some:
        for purpose in check.purposes:
            assert badness(verdict.purposes[purpose].grade) >= badness(AT_BEST[check.severity])
            assert verdict.purposes[purpose].grade != "good"


@given(checks, st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_a_larger_error_never_improves_anything(some: list[Check], one: float, other: float) -> None:
    small, large = (evidence(error, dict.fromkeys(JOINTS, error), error) for error in sorted((one, other)))
    before, after = grades(judge(some, small)), grades(judge(some, large))
    assert all(after[name] >= before[name] for name in before)


@given(checks, errors)
def test_every_purpose_has_a_reason_and_stands_in_the_headline(some: list[Check], known: Evidence | None) -> None:
    verdict = judge(some, known)
    assert set(verdict.purposes) == set(PURPOSES)
    headline = verdict.headline.lower().replace("usable, not good", "usable")
    for purpose, judged in verdict.purposes.items():
        assert judged.because
        before, _, _ = headline.partition(PURPOSE_WORDS[purpose])
        assert before.rfind(judged.grade) == max(before.rfind(grade) for grade in GRADES)
    order = [badness(one.grade) for one in verdict.joints]
    assert order == sorted(order, reverse=True)
    assert list(verdict.checks) == sorted(verdict.checks, key=lambda check: -badness(AT_BEST[check.severity]))


@given(checks, errors)
def test_a_verdict_survives_json(some: list[Check], known: Evidence | None) -> None:
    verdict, adapter = judge(some, known, "On val.h5."), TypeAdapter(Verdict)
    assert adapter.validate_json(adapter.dump_json(verdict)) == verdict
    assert set(asdict(verdict)) == {"headline", "purposes", "joints", "checks", "basis"}


@given(st.lists(st.tuples(checks, errors), min_size=1, max_size=3))
def test_several_together_are_as_bad_as_the_worst(parts: list[tuple[list[Check], Evidence | None]]) -> None:
    apart = [judge(some, known) for some, known in parts]
    whole = together([(f"file {i}", verdict) for i, verdict in enumerate(apart)])
    for purpose in PURPOSES:
        worst = max(badness(verdict.purposes[purpose].grade) for verdict in apart)
        assert badness(whole.purposes[purpose].grade) == worst
        reasons = {verdict.purposes[purpose].because for verdict in apart}
        assert whole.purposes[purpose].because.startswith("on file ") == (len(reasons) > 1)
    assert set(whole.checks) == {check for verdict in apart for check in verdict.checks}


def test_a_good_model_is_called_good() -> None:
    verdict = judge([], evidence(0.02, {"j1": 0.03, "j2": 0.05}))
    assert {one.grade for one in verdict.purposes.values()} == {"good"}
    assert verdict.headline.startswith("Good for torque prediction (feed-forward), collision detection and payload")
    assert verdict.joints[0].joint == "j2"


def test_nothing_held_out_is_not_good() -> None:
    assert judge([], evidence(None, {"j1": None}, None)).purposes["simulation"].grade == "usable"


def test_one_bad_joint_spoils_every_purpose_that_predicts_torque() -> None:
    verdict = judge([], evidence(0.03, {"j1": 0.02, "j2": 0.4}))
    assert verdict.purposes["simulation"].grade == "good"
    for purpose in set(PURPOSES) - {"simulation"}:
        assert verdict.purposes[purpose].grade == "poor"
        assert "j2" in verdict.purposes[purpose].because


def test_rest_counts_and_both_errors_are_said() -> None:
    known = Evidence(TorqueError(0.119, 0.056), {"j1": TorqueError(0.53, 0.06)})
    verdict = judge([], known)
    assert {one.grade for one in verdict.purposes.values()} == {"poor"}
    because = verdict.purposes["torque_prediction"].because
    assert "12 % over all samples (5.6 % in motion)" in because
    assert "53 % over all samples (6 % in motion)" in verdict.joints[0].because


def test_a_joint_with_hardly_any_torque_is_compared_with_what_it_is_rated_for() -> None:
    verdict = judge([], Evidence(TorqueError(0.01, 0.01), {"j1": TorqueError(0.5, 0.5, graded=0.02)}))
    assert verdict.purposes["torque_prediction"].grade == "good"
    assert verdict.joints[0].grade == "good"
    assert verdict.joints[0].error == 0.5


@given(torques, st.floats(0.0, 5.0))
def test_a_simulation_no_better_than_constant_velocity_is_poor(torque: TorqueError, ratio: float) -> None:
    known = Evidence(torque, {"j1": torque}, evidence(0.01, {"j1": 0.01}, ratio).motions)
    grade = judge([], known).purposes["simulation"].grade
    assert grade == "poor" or ratio < 1.0
    assert grade != "good" or ratio < 0.5
    resting = replace(torque, all_samples=2.0, in_motion=0.01)  # at rest a simulation has a stiction of its own
    at_rest = judge([], Evidence(resting, {"j1": resting}, evidence(0.01, {"j1": 0.01}, ratio).motions))
    assert at_rest.purposes["simulation"].grade == ("good" if ratio < 0.5 else "usable" if ratio < 1.0 else "poor")
    without = judge([], Evidence(torque, {"j1": torque})).purposes
    assert all(
        without[purpose] == judge([], known).purposes[purpose] for purpose in PURPOSES if purpose != "simulation"
    )


@given(checks, errors)
def test_reasons_read_as_reasons(some: list[Check], known: Evidence | None) -> None:
    """A note is no reason; what is good is so because of its error; usable is not good."""
    verdict = judge(some, known)
    notes = {CATALOGUE[check.name].meaning for check in some if check.severity == "note"}
    for judged in (*verdict.purposes.values(), *verdict.joints):
        assert not any(judged.because.startswith(meaning) for meaning in notes)
        assert judged.grade != "good" or "error" in judged.because or judged.because == "no check failed"
    assert "sable for" not in verdict.headline
    assert verdict.headline.count("because") >= 1


def test_a_check_about_a_joint_is_in_its_verdict() -> None:
    verdict = judge([raised("torque-sign", "check it", ["j2"])], evidence(0.01, {"j1": 0.2, "j2": 0.01}))
    assert [(one.joint, one.grade) for one in verdict.joints] == [("j2", "poor"), ("j1", "usable")]


def test_a_note_spoils_nothing_and_all_else_spoils_something() -> None:
    for name, kind in CATALOGUE.items():
        assert bool(kind.purposes) is (kind.severity != "note"), name
        assert kind.remedy.endswith("."), name
        assert not kind.meaning.endswith("."), name
        assert name == kind.name == kind.name.lower().replace("_", "-")


def test_the_catalogue_names_the_low_speed_of_the_errors() -> None:
    assert f"below {LOW_SPEED:g} rad/s" in CATALOGUE["errors-near-standstill"].meaning


def test_the_docs_have_the_catalogue() -> None:
    """`python -m studies.checks.checks_table` writes it."""
    assert markdown_lists() in DOCS.read_text(encoding="utf-8")
