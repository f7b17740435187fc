"""Columns that the user chooses: by number, by a pattern for all joints, by name; and what is listed as not taken."""

from __future__ import annotations

import tempfile
from pathlib import Path

import h5py
import numpy as np
import pytest
from each import each
from hypothesis import given, settings
from hypothesis import strategies as st
from three_links import NAMES, Arrays, content, make_robot, messages, samples, write_csv, write_npz

from daq.importers.choices import ImportChoices
from daq.importers.import_file import import_file
from daq.importers.roles import assign_roles
from drivers.core.errors import ImportFileError, InputError, UsageError

ROBOT = make_robot()


def without_header(folder: Path, columns: np.ndarray, separator: str = ",") -> Path:
    path = folder / "run.csv"
    path.write_text("\n".join(separator.join(map(repr, row)) for row in columns.tolist()))
    return path


@settings(max_examples=20)
@given(data=st.data())
def test_columns_by_number_in_any_order(data: st.DataObject) -> None:
    arrays = samples(20)
    kinds = ["t", "q", "torque"]
    order = data.draw(st.permutations(kinds))
    separator = data.draw(st.sampled_from([",", ";", "\t", " "]))
    columns, choices, start = [], {}, 1
    for kind in order:
        block = arrays[kind].reshape(20, -1)
        if data.draw(st.booleans()):  # a column that means nothing, before
            columns.append(np.full((20, 1), 7.0))
            start += 1
        last = start + block.shape[1] - 1
        spelled = [f"{start}-{last}", f"{start} - {last}", ",".join(map(str, range(start, last + 1)))]
        choices[kind] = str(start) if kind == "t" else data.draw(st.sampled_from(spelled))
        columns.append(block)
        start = last + 1
    with tempfile.TemporaryDirectory() as folder:
        path = without_header(Path(folder), np.column_stack(columns), separator)
        found = content(import_file(path, ROBOT, ImportChoices(columns=choices)))
    for kind, name in (("t", "time"), ("q", "position"), ("torque", "torque")):
        np.testing.assert_array_equal(found[name], arrays[kind])


def test_columns_by_number_beside_a_header_and_a_rate(tmp_path: Path) -> None:
    arrays = samples(20)
    path = write_csv(tmp_path, {"x": arrays["t"], "y": arrays["q"]})
    found = content(import_file(path, ROBOT, ImportChoices(columns={"position": "2-4"}, rate=125.0)))
    np.testing.assert_array_equal(found["position"], arrays["q"])
    path = without_header(tmp_path, arrays["q"])
    recording = import_file(path, ROBOT, ImportChoices(columns={"q3": "1", "q2": "2", "q1": "3"}, rate=125.0))
    np.testing.assert_array_equal(content(recording)["position"], arrays["q"][:, ::-1])


@pytest.mark.parametrize("pattern", ["{}_pos", "pos {} x"])
@pytest.mark.parametrize("count_from", [0, 1])
def test_a_pattern_stands_for_the_joints_numbers(tmp_path: Path, pattern: str, count_from: int) -> None:
    arrays = samples(20)
    columns = {pattern.format(k + count_from) + " [deg]": np.degrees(arrays["q"][:, k]) for k in (2, 0, 1)}
    path = write_csv(tmp_path, {"t": arrays["t"], **columns, "pos x": arrays["t"]})
    recording = import_file(path, ROBOT, ImportChoices(columns={"position": pattern}))
    np.testing.assert_allclose(content(recording)["position"], arrays["q"], rtol=1e-14)
    assert "position converted from deg: all joints" in messages(recording)
    assert "not imported: pos x" in messages(recording)


def test_a_pattern_stands_for_the_joints_names(tmp_path: Path) -> None:
    arrays = samples(20)
    columns = {f"encoder of {name}": arrays["q"][:, k] for k, name in reversed(list(enumerate(NAMES)))}
    path = write_npz(tmp_path, {"t": arrays["t"], **columns})
    found = content(import_file(path, ROBOT, ImportChoices(columns={"position": "encoder of {}"})))
    np.testing.assert_array_equal(found["position"], arrays["q"])


def test_units_give_the_meaning_of_names_in_another_language(tmp_path: Path) -> None:
    arrays = samples(20)
    angles = {f"Winkel {k + 1} [°]": np.degrees(arrays["q"][:, k]) for k in (2, 0, 1)}
    moments = {f"M{k + 1} (Nm)": arrays["torque"][:, k] for k in range(3)}
    columns = {"Zeit [ms]": 1e3 * arrays["t"], **angles, **moments, "Moment (Nm)": arrays["t"]}
    recording = import_file(write_csv(tmp_path, columns), ROBOT, ImportChoices())
    found = content(recording)
    for kind, name in (("t", "time"), ("q", "position"), ("torque", "torque")):
        np.testing.assert_allclose(found[name], arrays[kind], rtol=1e-14)
    assert "recognised by the unit alone: Zeit [ms] (time), " in messages(recording)
    assert "not imported: Moment (Nm)" in messages(recording)


@pytest.mark.parametrize(
    "names",
    [
        ["Soll1 [°]", "Soll2 [°]", "Soll3 [°]", "Ist1 [°]", "Ist2 [°]", "Ist3 [°]"],  # two groups: which one?
        ["Motor position 1 [deg]", "Motor position 2 [deg]", "Motor position 3 [deg]"],
        ["error 1 [rad]", "error 2 [rad]", "error 3 [rad]"],
        ["Winkel 1 [°]", "Winkel 2 [°]"],
    ],
)
def test_units_that_leave_a_choice_give_no_meaning(names: list[str]) -> None:
    assert assign_roles(names, NAMES, {}, "run.csv") == ()


CSV = ["a", "b1", "b2", "b3", "b3 [deg]", "c", "c"]


@each(
    ("choice", "error", "message"),
    [
        ({"position": "9"}, ImportFileError, "columns 1 to 7, but --column asks for 9"),
        ({"position": "0-2"}, ImportFileError, "counted from 1"),
        ({"position": "4-2"}, ImportFileError, "a range goes upwards"),
        ({"t": "1-2"}, UsageError, "one name to 2 columns"),
        ({"q1": "1,2"}, UsageError, "one name to 2 columns"),
        ({"q1": "6"}, ImportFileError, "several columns called 'c'; rename them"),
        ({"q1": "b{}"}, UsageError, "a pattern has one {} and is for a whole quantity"),
        ({"t": "b{}"}, UsageError, "for a whole quantity"),
        ({"q": "b{}{}"}, UsageError, "a pattern has one"),
        ({"q": "d{}"}, ImportFileError, r"no column that fits --column q=d\{\}; it has: a, b1"),
        ({"q": "b{}"}, ImportFileError, r"several columns fit .* alike: b3, b3 \[deg\]"),
        ({"q1": "bb1"}, ImportFileError, "did you mean 'b1'"),
    ],
)
def test_choices_that_fit_nothing_are_refused(choice: dict[str, str], error: type[InputError], message: str) -> None:
    with pytest.raises(error, match=message):
        assign_roles(CSV, NAMES, choice, "run.csv", numbered=True)


keys = st.sampled_from(["t", "q", "position", "q1", "current", "torque2", "elbow.position", "x", ""])
chosen = st.text("0123456789-, ", max_size=8) | st.sampled_from(["b{}", "{}", "c", "b1", "{}{}"]) | st.text(max_size=6)


@given(st.dictionaries(keys, chosen, max_size=3), st.booleans())
def test_any_choice_is_roles_or_refused(columns: dict[str, str], numbered: bool) -> None:
    names = ["a", "b1", "b2", "t", "q2"]
    problem = ""
    try:
        roles = assign_roles(names, NAMES, columns, "run.csv", numbered=numbered)
    except InputError as error:
        roles, problem = (), str(error)
    assert "\n" not in problem
    assert all(role.name in names for role in roles)


def test_numbers_mean_nothing_where_columns_have_no_order(tmp_path: Path) -> None:
    path = write_npz(tmp_path, samples(20))
    with pytest.raises(ImportFileError, match="has no '2-4'"):
        import_file(path, ROBOT, ImportChoices(columns={"position": "2-4"}))


def test_every_unused_field_is_listed_with_its_shape(tmp_path: Path) -> None:
    from scipy.io import savemat

    arrays = samples(20)
    spare = {f"spare{k}": np.zeros((20, k)) for k in range(1, 40)}
    inner = {"deep": {"target": np.zeros((20, 3)), "f": {"g": 1.0}}, "text": "hello", "cell": np.array([1, {}], object)}
    savemat(tmp_path / "run.mat", {"data": {"time": arrays["t"], "q": arrays["q"], **inner}, **spare})
    text = messages(import_file(tmp_path / "run.mat", ROBOT, ImportChoices()))
    for name in [f"spare{k} (20 × {k})" for k in spare_numbers(spare)]:
        assert name in text
    for name in ("data.deep.target (20 × 3)", "data.deep.f.g (1 × 1)", "data.text (text)", "data.cell"):
        assert name in text
    found = import_file(tmp_path / "run.mat", ROBOT, ImportChoices(columns={"velocity": "data.deep.target"}))
    np.testing.assert_array_equal(content(found)["velocity"], 0.0)
    savemat(tmp_path / "other.mat", spare)
    with pytest.raises(ImportFileError, match=r"it has: .*spare7 \(20 × 7\).*spare39 \(20 × 39\)"):
        import_file(tmp_path / "other.mat", ROBOT, ImportChoices())


def spare_numbers(spare: Arrays) -> list[int]:
    return [int(name.removeprefix("spare")) for name in spare]


def test_groups_within_groups_are_found_and_endless_ones_end(tmp_path: Path) -> None:
    arrays = samples(20)
    with h5py.File(tmp_path / "run.h5", "w") as file:
        file["a/b/c/t"], file["a/b/c/q"] = arrays["t"], arrays["q"]
    found = content(import_file(tmp_path / "run.h5", ROBOT, ImportChoices()))
    np.testing.assert_array_equal(found["position"], arrays["q"])
    with h5py.File(tmp_path / "run.h5", "a") as file:
        file["a/again"] = h5py.SoftLink("/a")
    recording = import_file(tmp_path / "run.h5", ROBOT, ImportChoices())
    assert "not imported: a.again" in messages(recording)
