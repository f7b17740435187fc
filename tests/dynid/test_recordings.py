"""Recordings from arrays, from files and as xarray datasets; robots from URDFs."""

from __future__ import annotations

import builtins

import numpy as np
import pytest
from each import each

import dynid

URDF = """\
<robot name="two_links">
  <link name="base"/><link name="upper"/><link name="lower"/><link name="flange"/>
  <joint name="elbow" type="prismatic"><parent link="upper"/><child link="lower"/><origin xyz="0.3 0 0"/>
    <axis xyz="1 0 0"/><limit lower="-0.2" upper="0.2" velocity="0.5" effort="80"/></joint>
  <joint name="shoulder" type="continuous"><parent link="base"/><child link="upper"/>
    <axis xyz="0 1 0"/><limit velocity="2" effort="0"/></joint>
  <joint name="tool" type="fixed"><parent link="lower"/><child link="flange"/></joint>
</robot>
"""


def arrays(run: dynid.Recording) -> dict[str, np.ndarray]:
    stream = run.streams["joints"]
    return {"time": stream.time, **{name: channel.values for name, channel in stream.channels.items()}}


@pytest.mark.usefixtures("estimate_alone")
def test_arrays_identify_as_their_file_does(run, other, result, tmp_path):
    given = dynid.Recording.from_arrays("ur5e", **arrays(run), comment="mine")
    held_out = dynid.Recording.from_arrays(dynid.load_robot("ur5e"), **arrays(other))
    dynid.write_recording(tmp_path / "run.h5", given)
    dynid.write_recording(tmp_path / "other.h5", held_out)
    from_arrays = dynid.identify(given, validation=held_out)
    from_files = dynid.identify(tmp_path / "run.h5", validation=[str(tmp_path / "other.h5")])
    for one in (from_arrays, from_files):
        np.testing.assert_array_equal(one.parameters["value"], result.parameters["value"])
        np.testing.assert_array_equal(one.parameters["std"], result.parameters["std"])
    assert given.comment == "mine"
    assert given.streams["joints"].channels["position"].columns == given.robot().robot.joint_names


def test_two_recordings_in_memory_keep_their_own_windows_and_hashes(result):
    learnt, held_out = result.result.recordings
    assert (learnt.role, held_out.role) == ("identification", "validation")
    assert learnt.sha256 != held_out.sha256
    assert len(learnt.sha256) == 64


@each(
    ("change", "message"),
    [
        ({"position": lambda q: q.T}, r"position: has shape \(6, 400\); \(400, 6\) is needed \(it is transposed"),
        ({"position": lambda q: q[:, :5]}, r"position: has shape \(400, 5\); \(400, 6\) is needed \(one row per sam"),
        ({"position": lambda q: q[:10]}, r"position: has shape \(10, 6\)"),
        ({"position": lambda q: q[0]}, r"position: has shape \(6,\)"),
        ({"position": np.rad2deg}, "position: reaches .* these are degrees .*deg2rad"),
        ({"position": lambda q: np.rad2deg(0.1 * np.sin(30 * q))}, "per second: these are degrees"),
        ({"position": lambda q: [["a"] * 6] * 400}, "position: does not consist of numbers"),
        (
            {"current": lambda i: np.where(np.arange(400)[:, None] == 7, np.nan, i)},
            "current: 1 of 400 samples have NaN",
        ),
        ({"current": lambda i: np.full_like(i, np.inf)}, "current: 400 of 400 samples have NaN or infinite"),
        ({"velocity": np.rad2deg}, "velocity: of joint .* looks like degrees"),
        ({"time": lambda t: t[::-1]}, "time: goes backward at sample 1 .*sort all arrays"),
        ({"time": lambda t: np.repeat(t[::2], 2)}, "time: repeats the stamp before at sample 1"),
        ({"time": lambda t: 1e3 * t}, "time: 0.1 samples per second .*the stamps look like ms"),
        ({"time": lambda t: t[:, None]}, r"time: has shape \(400, 1\); \(N,\) is needed"),
        ({"time": lambda t: np.where(t > 1, np.nan, t)}, "time: is not finite"),
        ({"time": lambda t: t[:0]}, r"time: holds 0 samples"),
        ({"time": lambda t: None}, r"time: has shape \(\)"),
        ({"current": lambda i: None}, "neither current, voltage nor torque is given"),
    ],
)
def test_hostile_arrays_are_refused_in_one_line(change, message):
    time = np.arange(400) / 100.0
    position = 0.8 * np.sin(np.outer(time, np.linspace(1, 2, 6)))
    velocity = np.gradient(position, time, axis=0)
    given = {"time": time, "position": position, "velocity": velocity, "current": 3 * position}
    given |= {name: function(given[name]) for name, function in change.items()}
    with pytest.raises(dynid.DataError, match=message) as refused:
        dynid.Recording.from_arrays("ur5e", **given)
    assert "\n" not in str(refused.value)


def test_an_unknown_robot_is_refused():
    with pytest.raises(dynid.RobotFileError, match="did you mean 'ur5e'"):
        dynid.Recording.from_arrays("ur5", time=[0, 1], position=[[0] * 6] * 2, torque=[[0] * 6] * 2)


def test_the_callers_arrays_are_not_shared():
    time = np.arange(400) / 100.0
    position = 0.8 * np.sin(np.outer(time, np.linspace(1, 2, 6)))
    run = dynid.Recording.from_arrays("ur5e", time=time, position=position, torque=position)
    position[:] = 0.0
    assert np.ptp(run.streams["joints"].channels["position"].values) > 0.1


def test_a_dataset_has_units_and_joints(run):
    pytest.importorskip("xarray")
    dataset = run.to_xarray()
    assert dataset["position"].dims == ("time", "joint")
    assert dataset["current"].attrs["units"] == "A"
    assert list(dataset["joint"].values) == list(run.robot().robot.joint_names)
    with pytest.raises(dynid.UsageError, match="no stream 'torch'"):
        run.to_xarray("torch")


@pytest.mark.parametrize("missing", ["xarray", "pandas"])
def test_without_the_optional_package_it_says_so(run, result, monkeypatch, missing):
    real = builtins.__import__

    def without(name: str, *arguments: object, **named: object) -> object:
        if name == missing:
            raise ImportError(name)
        return real(name, *arguments, **named)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(dynid.UsageError, match=f"needs {missing} .*pip install"):
        run.to_xarray() if missing == "xarray" else result.parameters.to_frame()


def test_a_urdf_is_a_robot(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(URDF, encoding="utf-8")
    robot_file = dynid.load_robot(path)
    robot = robot_file.robot
    assert robot.name == "two_links"
    assert robot.joint_names == ("shoulder", "elbow")  # parents first
    assert robot.joints[0].torque is None
    assert robot.joints[1].position == (-0.2, 0.2)
    assert robot_file.prismatic_joints == {"elbow"}
    assert len(dynid.base_parameters(path)) > 3
    run = dynid.Recording.from_arrays(
        path, time=np.arange(100) / 50, position=np.full((100, 2), 0.1), torque=np.zeros((100, 2))
    )
    assert run.robot().urdf_text == URDF


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<robot", "is not a URDF"),
        ("<robot name='x'><link name='a'/></robot>", "has no movable joint"),
        (URDF.replace('lower="-0.2" ', ""), "joint elbow: states no position limit"),
        (URDF.replace('velocity="0.5"', 'velocity="fast"'), "a limit that is not a number"),
    ],
)
def test_a_broken_urdf_is_refused(tmp_path, text, message):
    path = tmp_path / "arm.urdf"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(dynid.RobotFileError, match=message):
        dynid.load_robot(path)
