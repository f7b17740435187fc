"""What the user decides about an import: columns, units, effort, rate, and repairs only when asked for."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from three_links import DEGREE, content, make_robot, messages, samples, write_csv, write_npz

from daq.importers.choices import ImportChoices
from daq.importers.import_file import import_file
from daq.recording.recording import JOINTS_STREAM
from daq.robot.loader import RobotFile
from drivers.core.errors import ImportFileError


@pytest.fixture(scope="module")
def robot() -> RobotFile:
    return make_robot()


# --- choices and units ----------------------------------------------------------------------------------------------


def test_columns_by_option(tmp_path: Path, robot: RobotFile) -> None:
    arrays = samples(20)
    columns = {"tick": arrays["t"]} | {f"JointPos{k}": arrays["q"][:, k - 1] for k in (1, 2, 3)} | {"q7": arrays["t"]}
    mapping = {"t": "tick", "q1": "JointPos3", "q2": "JointPos2", "q3": "JointPos1"}
    recording = import_file(write_csv(tmp_path, columns), robot, ImportChoices(columns=mapping))
    np.testing.assert_array_equal(content(recording)["position"], arrays["q"][:, ::-1])
    assert "not imported: q7" in messages(recording)
    assert "neither torque nor current" in messages(recording)
    path = write_npz(tmp_path, {"run.a": arrays["q"], "run.b": arrays["q"] + 1.0, "t": arrays["t"]})
    recording = import_file(path, robot, ImportChoices(columns={"q": "run.b"}))
    np.testing.assert_array_equal(content(recording)["position"], arrays["q"] + 1.0)


def test_degrees_by_option_spare_prismatic_joints(tmp_path: Path) -> None:
    arrays = samples()
    degrees = np.array([1.0, 1.0, DEGREE]) / DEGREE
    path = write_csv(tmp_path, {"t": arrays["t"], "q": arrays["q"] * degrees, "qd": arrays["qd"] * degrees})
    recording = import_file(path, make_robot("prismatic"), ImportChoices(degrees=True))
    np.testing.assert_allclose(content(recording)["position"], arrays["q"], rtol=1e-14)
    np.testing.assert_allclose(content(recording)["velocity"], arrays["qd"], rtol=1e-14)
    assert "position converted from deg: shoulder, elbow" in messages(recording)
    assert "prismatic joints not converted from degrees: wrist" in messages(recording)


@pytest.mark.parametrize(("factor", "unit", "hint"), [(1e3, "mm", r"q1 \[mm\]"), (1e7, "encoder counts", "convert")])
def test_a_sliding_joint_in_another_unit_is_refused_with_its_name(
    tmp_path: Path, factor: float, unit: str, hint: str
) -> None:
    arrays = samples()
    path = write_csv(tmp_path, {"t": arrays["t"], "q": arrays["q"] * np.array([1.0, 1.0, factor])})
    with pytest.raises(ImportFileError, match=f"(?s)it looks like {unit}.*{hint}"):
        import_file(path, make_robot("prismatic"), ImportChoices())


def test_units_in_the_header_are_honoured(tmp_path: Path, robot: RobotFile) -> None:
    arrays = samples()
    text = ["t [ms];" + ";".join([*(f"q{k} (deg)" for k in (1, 2, 3)), *(f"current{k} [mA]" for k in (1, 2, 3))])]
    for row in range(200):
        numbers = [arrays["t"][row] * 1e3, *(arrays["q"][row] / DEGREE), *(arrays["current"][row] * 1e3)]
        text.append(";".join(repr(float(number)) for number in numbers))
    path = tmp_path / "run.csv"
    path.write_text("\ufeff# made by a logger\r\n" + "\r\n".join(text), encoding="utf-8")
    recording = import_file(path, robot, ImportChoices(degrees=True))
    found = content(recording)
    np.testing.assert_allclose(found["time"], arrays["t"], atol=1e-15)
    np.testing.assert_allclose(found["position"], arrays["q"], rtol=1e-14)
    np.testing.assert_allclose(found["current"], arrays["current"], rtol=1e-14)
    assert "position converted from deg: all joints" in messages(recording)
    assert "current converted from mA" in messages(recording)


def test_units_in_an_npz_meta_are_honoured(tmp_path: Path, robot: RobotFile) -> None:
    arrays = samples()
    meta = json.dumps({"units": {"q": "deg", "torque": "N·m", "elsewhere": "furlong"}})
    path = write_npz(tmp_path, {"t": arrays["t"], "q": arrays["q"] / DEGREE, "torque": arrays["torque"], "meta": meta})  # type: ignore[dict-item]
    np.testing.assert_allclose(content(import_file(path, robot, ImportChoices()))["position"], arrays["q"], rtol=1e-14)


def test_kelvin_zero_based_numbers_and_partial_temperatures(tmp_path: Path, robot: RobotFile) -> None:
    arrays = samples(20)
    columns = {"timestamp": arrays["t"]} | {f"actual_q_{k}": arrays["q"][:, k] for k in range(3)}
    columns |= {"temperature2 [K]": np.full(20, 300.15), "current": np.ones(20)}
    recording = import_file(write_csv(tmp_path, columns), robot, ImportChoices())
    temperature = recording.streams[JOINTS_STREAM].channels["temperature"]
    assert temperature.columns == ("elbow",)
    np.testing.assert_allclose(temperature.values, 27.0)
    assert "counted from 0" in messages(recording)
    assert "no temperature for some joints" in messages(recording)
    assert "not imported: current" in messages(recording)  # one column: the whole arm's


@pytest.mark.parametrize("effort", ["torque", "current"])
def test_effort_is_what_the_user_says(tmp_path: Path, robot: RobotFile, effort: Any) -> None:
    arrays = samples(20)
    path = write_npz(tmp_path, {"t": arrays["t"], "q": arrays["q"], "effort": arrays["torque"]})
    found = content(import_file(path, robot, ImportChoices(effort=effort)))
    np.testing.assert_array_equal(found[effort], arrays["torque"])
    assert set(found) == {"time", "position", effort}


def test_a_rate_stands_in_for_missing_stamps_and_is_recorded(tmp_path: Path, robot: RobotFile) -> None:
    arrays = samples(20)
    recording = import_file(write_npz(tmp_path, {"q": arrays["q"]}), robot, ImportChoices(rate=125.0))
    np.testing.assert_allclose(content(recording)["time"], arrays["t"])
    assert "uniform stamps at 125 Hz were assumed" in messages(recording)


@pytest.mark.parametrize(("unit", "scale"), [("s", 1), ("ms", 10**3), ("us", 10**6), ("ns", 10**9)])
def test_stamps_since_1970_start_at_zero(tmp_path: Path, robot: RobotFile, unit: Any, scale: int) -> None:
    stamps = np.arange(20) * (scale // 125 if scale > 1 else 0.008) + 1_700_000_000 * scale
    path = write_npz(tmp_path, {"t": stamps, "q": samples(20)["q"]})
    recording = import_file(path, robot, ImportChoices(time_unit=unit))
    np.testing.assert_allclose(content(recording)["time"], np.arange(20) / 125.0, atol=3e-7 if unit == "s" else 1e-12)
    assert "stamped 17000" in messages(recording)


def test_structs_and_transposed_arrays(tmp_path: Path, robot: RobotFile) -> None:
    from scipy.io import savemat

    arrays = samples(20)
    savemat(tmp_path / "run.mat", {"data": {"time": arrays["t"], "q": arrays["q"].T}, "note": "hello"})
    recording = import_file(tmp_path / "run.mat", robot, ImportChoices())
    np.testing.assert_array_equal(content(recording)["position"], arrays["q"])
    assert "'data.q' was stored joints × samples and has been transposed" in messages(recording)
    with h5py.File(tmp_path / "foreign.h5", "w") as file:
        file["run/t"], file["run/q"] = arrays["t"], arrays["q"]
    found = content(import_file(tmp_path / "foreign.h5", robot, ImportChoices()))
    np.testing.assert_array_equal(found["position"], arrays["q"])


def test_header_in_a_comment(tmp_path: Path, robot: RobotFile) -> None:
    arrays = samples(20)
    table = np.column_stack([arrays["t"], arrays["q"]])
    np.savetxt(tmp_path / "run.txt", table, header="t q1 q2 q3", fmt="%.17g")
    recording = import_file(tmp_path / "run.txt", robot, ImportChoices())
    np.testing.assert_array_equal(content(recording)["position"], arrays["q"])
    assert "header was taken from the comment in line 1" in messages(recording)


# --- repairs --------------------------------------------------------------------------------------------------------


def test_repairs_are_made_when_asked_for_and_recorded(tmp_path: Path, robot: RobotFile) -> None:
    arrays = samples(30)
    broken = {name: values.copy() for name, values in arrays.items()}
    broken["q"][4, 1] = np.nan
    broken["t"][10] = broken["t"][9]
    swap = [*range(20), 21, 20, *range(22, 30)]
    path = write_npz(tmp_path, {name: values[swap] for name, values in broken.items()})
    recording = import_file(path, robot, ImportChoices(repair=frozenset({"drop-nan", "sort", "drop-duplicates"})))
    keep = [k for k in range(30) if k not in (4, 10)]
    np.testing.assert_array_equal(content(recording)["time"], arrays["t"][keep])
    np.testing.assert_array_equal(content(recording)["torque"], arrays["torque"][keep])
    text = messages(recording)
    assert "warning: drop-nan: 1 of 30 samples dropped, first: sample 4" in text
    assert "warning: sort: time went backward 1 time, first at sample 20 by 0.008 s" in text
    assert "warning: drop-duplicates: 1 of 29 samples dropped, first: sample 9" in text


@settings(max_examples=15, deadline=None)
@given(data=st.data())
def test_repaired_files_equal_what_was_sound(data: st.DataObject) -> None:
    """Shuffle, repeat and spoil rows at will: the repairs leave exactly the sound samples."""
    arrays = samples(30)
    spoilt = data.draw(st.sets(st.integers(0, 29), max_size=20))
    order = data.draw(st.permutations(range(30)))
    repeated = data.draw(st.lists(st.integers(0, 29), max_size=5))
    torque = arrays["torque"].copy()
    torque[sorted(spoilt), 2] = np.inf
    index = [*order, *repeated]
    with tempfile.TemporaryDirectory() as folder:
        path = write_npz(Path(folder), {"t": arrays["t"][index], "q": arrays["q"][index], "torque": torque[index]})
        choices = ImportChoices(repair=frozenset({"drop-nan", "sort", "drop-duplicates"}))
        found = content(import_file(path, make_robot(), choices))
    keep = [k for k in range(30) if k not in spoilt]
    np.testing.assert_array_equal(found["time"], arrays["t"][keep])
    np.testing.assert_array_equal(found["torque"], arrays["torque"][keep])


def test_doubts_are_recorded(tmp_path: Path, robot: RobotFile) -> None:
    arrays = samples()
    path = write_npz(tmp_path, {**arrays, "current": arrays["current"] * 1e3, "torque": arrays["torque"] * 1e3})
    text = messages(import_file(path, robot, ImportChoices()))
    assert "is it in mA?" in text
    assert "torque of shoulder reaches" in text
    path = write_npz(tmp_path, {**arrays, "q": arrays["q"] * 2.5})
    text = messages(import_file(path, robot, ImportChoices()))
    assert "position of elbow is 0.5" in text
    assert "velocity is not the change of position" in text
    path = write_npz(tmp_path, arrays)
    assert "were they in radians already?" in messages(import_file(path, robot, ImportChoices(degrees=True)))


def test_the_sign_of_all_torques_is_changed_when_asked_for(tmp_path: Path, robot: RobotFile) -> None:
    arrays = samples(20)
    path = write_npz(tmp_path, arrays | {"torque": 3.0 * arrays["q"]})
    recording = import_file(path, robot, ImportChoices(repair=frozenset({"opposite-torque"})))
    np.testing.assert_array_equal(content(recording)["torque"], -3.0 * arrays["q"])
    np.testing.assert_array_equal(content(recording)["position"], arrays["q"])
    assert "warning: opposite-torque: the sign of torque, current was changed" in messages(recording)


def test_stamps_of_a_counter_that_began_anew_go_on_when_asked(tmp_path: Path, robot: RobotFile) -> None:
    arrays = samples(60)
    counter = np.round(arrays["t"] * 1e6) + 2**32 - 50_000
    path = write_npz(tmp_path, {**arrays, "t": counter % 2**32 * 1e-6})
    recording = import_file(path, robot, ImportChoices(repair=frozenset({"unwrap"})))
    time = content(recording)["time"]
    np.testing.assert_allclose(time - time[0], arrays["t"] - arrays["t"][0], atol=1e-5)
    assert "warning: unwrap: the counter of the stamps restarted 1 time" in messages(recording)
