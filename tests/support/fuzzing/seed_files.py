"""Sound files of every kind that a command reads, of a small arm, to be damaged."""

from __future__ import annotations

import os
import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import scipy.io

import dynid

ROBOT = """\
name: two-links
model:
  mdh:
    - {joint: shoulder, alpha: 0, d: 0, r: 0.3, antecedent: base}
    - {joint: elbow, alpha: pi/2, d: 0.4, r: 0, antecedent: shoulder}
  gravity: [0, 0, -9.81]
  mounting: table
joints:
  - {name: shoulder, position: [-3, 3], velocity: 2, acceleration: 10, torque: 50, temperature: 70}
  - {name: elbow, position: [-2, 2], velocity: 2, acceleration: 10, torque: 50, temperature: 70}
drives:
  - {joint: shoulder, gain: 10, gain_std: 0.5, signal: current}
  - {joint: elbow, gain: 8, gain_std: 0.5, signal: current}
friction: {model: coulomb-viscous, offset: true}
workspace: {floor: -2}
truth:
  links:
    shoulder: {mass: 5, com: [0.1, 0, 0.05], inertia: [0.05, 0, 0, 0.06, 0, 0.07]}
    elbow: {mass: 3, com: [0.2, 0, 0.01], inertia: [0.02, 0, 0, 0.03, 0, 0.03]}
  joints:
    shoulder: {viscous: 1, coulomb: 2}
    elbow: {viscous: 0.5, coulomb: 1}
  noise: {rate: 100, torque_std: {shoulder: 0.1, elbow: 0.1}}
connections:
  can:
    driver: can_frames
    interface: virtual
    channel: fuzz
    bitrate: 1000000
    rate: 100
    signals:
      - {id: 0x101, joint: shoulder, quantity: position, start: 0, length: 32, signed: true, scale: 0.001, unit: rad}
      - {id: 0x101, joint: elbow, quantity: position, start: 32, length: 32, signed: true, scale: 0.001, unit: rad}
"""
URDF = """\
<robot name="two-links">
  <link name="base"/>
  <link name="upper"><inertial><mass value="5"/><origin xyz="0.1 0 0.05" rpy="0 0 0"/>
    <inertia ixx="0.05" ixy="0" ixz="0" iyy="0.06" iyz="0" izz="0.07"/></inertial></link>
  <link name="fore"><inertial><mass value="3"/><origin xyz="0.2 0 0.01"/>
    <inertia ixx="0.02" ixy="0" ixz="0" iyy="0.03" iyz="0" izz="0.03"/></inertial>
    <collision><geometry><cylinder radius="0.05" length="0.3"/></geometry></collision></link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
    <origin xyz="0 0 0.3" rpy="0 0 0"/><axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" velocity="2" effort="50"/></joint>
  <joint name="elbow" type="revolute"><parent link="upper"/><child link="fore"/>
    <origin xyz="0.4 0 0" rpy="1.5708 0 0"/><axis xyz="0 0 1"/>
    <limit lower="-2" upper="2" velocity="2" effort="50"/></joint>
</robot>
"""
MESHES = ("fore.stl", "fore.obj", "text.stl", "fore.dae")
SIZE = ((0.0, 0.0, 0.0), (0.3, 0.0, 0.0), (0.0, 0.05, 0.0), (0.0, 0.0, 0.05))
"""Corners of a tetrahedron [m], the mesh of a link."""
SIDES = ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3))
TRAJECTORIES = {
    "fourier": "kind: fourier\nperiod: 4\noffset: [0, 0]\nsine: [[0.2, 0.1], [0.1, 0.2]]\n"
    "cosine: [[0.1, 0], [0, 0.1]]\nperiods: 1\nramp: 2\n",
    "quintic": "kind: fourier-quintic\nperiod: 4\noffset: [0, 0]\nsine: [[0.2, 0.1], [0.1, 0.2]]\n"
    "cosine: [[0.1, 0], [0, 0.1]]\nperiods: 1\n",
    "sines": "kind: sines\nduration: 5\noffset: [0, 0]\namplitude: [[0.1, 0.2], [0.1, 0.1]]\n"
    "frequency: [[1, 2], [1, 1.5]]\nramp: 1\n",
    "points": "kind: points\npoints: [[0, 0], [0.5, 0.2], [0, 0]]\ndurations: [2, 2]\ndwell: 0.5\n",
    "samples": "kind: samples\ntime: [0, 1, 2, 3, 4]\nposition: [[0, 0], [0, 0], [0.01, 0.01], [0, 0], [0, 0]]\n",
}
DAE = (
    '<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1"><asset><unit meter="1"/></asset>'
    '<library_geometries><geometry id="g"><mesh><source id="p"><float_array id="pa" count="12">{places}</float_array>'
    '<technique_common><accessor source="#pa" count="4" stride="3"><param name="X" type="float"/>'
    '<param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>'
    '<vertices id="v"><input semantic="POSITION" source="#p"/></vertices><triangles count="4">'
    '<input semantic="VERTEX" source="#v" offset="0"/><p>{sides}</p></triangles></mesh></geometry></library_geometries>'
    '<library_visual_scenes><visual_scene id="s"><node><instance_geometry url="#g"/></node></visual_scene>'
    '</library_visual_scenes><scene><instance_visual_scene url="#s"/></scene></COLLADA>'
)
LIMITS = "relative_error: 0.5\nrmse: {shoulder: 5, elbow: 3}\npurposes: {simulation: usable}\n"
DBC = """\
VERSION ""
BU_: arm
BO_ 257 State: 8 arm
 SG_ position_shoulder : 0|32@1- (0.001,0) [0|0] "rad" pc
 SG_ position_elbow : 32|32@1- (0.001,0) [0|0] "rad" pc
"""
JOINT_STATE = "sensor_msgs/msg/JointState"


@dataclass(frozen=True)
class Seeds:
    """Sound files."""

    folder: Path  # that holds all of them; a command runs in a copy of it
    kinds: dict[str, tuple[str, ...]]  # kind → the files of this kind in it, to be damaged


def make_seeds(folder: Path) -> Seeds:
    """Write all seed files into a folder."""
    place = Path.cwd()
    os.chdir(folder)
    try:
        Path("arm.yaml").write_text(ROBOT)
        Path("arm.urdf").write_text(URDF)
        Path("limits.yaml").write_text(LIMITS)
        Path("dbc-arm.yaml").write_text(_with_dbc())
        Path("arm.dbc").write_text(DBC)
        _write_meshes()
        for name, text in TRAJECTORIES.items():
            Path(f"{name}.yaml").write_text(f"robot: two-links\n{text}")
        run = dynid.simulate("arm.yaml", duration=8.0, seed=1, rate=50.0)
        dynid.write_recording("run.h5", run)
        dynid.write_recording("val.h5", dynid.simulate("arm.yaml", duration=8.0, seed=2, rate=50.0))
        for number, name in enumerate(("model", "other")):
            dynid.identify(dynid.simulate("arm.yaml", duration=8.0, seed=3 + number, rate=50.0)).save(name)
            Path(name, "result.json").rename(f"{name}.json")
            Path(name, "report.html").unlink()
            Path(name).rmdir()
        stream = run.streams["joints"]
        columns = {
            "t": stream.time,
            "q": stream.channels["position"].values,
            "current": stream.channels["current"].values,
        }
        _write_tables(columns)
        _write_bags(columns)
    finally:
        os.chdir(place)
    return Seeds(
        folder,
        {
            "recording": ("run.h5",),
            "robot file": ("arm.yaml",),
            "URDF": ("arm.urdf",),
            "mesh": MESHES,
            "trajectory": tuple(f"{name}.yaml" for name in TRAJECTORIES),
            "result": ("model.json",),
            "limits": ("limits.yaml",),
            "DBC": ("arm.dbc",),
            "CSV": ("run.csv", "blanks.txt"),
            "npz": ("run.npz", "packed.npz"),
            "mat": ("run.mat", "packed.mat", "old.mat"),
            "HDF5": ("foreign.hdf5", "packed.hdf5"),
            "db3": ("run.db3",),
            "MCAP": ("run.mcap", "packed.mcap"),
        },
    )


def _write_meshes() -> None:
    """One tetrahedron in every format, and an arm of each in which it is a link's collision shape."""
    corners = np.array(SIZE)
    triangles = corners[np.array(SIDES)].astype("<f4")
    facets = b"".join(bytes(12) + triangle.tobytes() + bytes(2) for triangle in triangles)
    Path("fore.stl").write_bytes(bytes(80) + struct.pack("<I", len(SIDES)) + facets)
    lines = [f"v {x} {y} {z}" for x, y, z in SIZE] + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in SIDES]
    Path("fore.obj").write_text("\n".join(lines) + "\n")
    loops = ("".join(f"vertex {x} {y} {z}\n" for x, y, z in triangle) for triangle in triangles)
    facets_of_text = "".join(f"facet normal 0 0 1\nouter loop\n{loop}endloop\nendfacet\n" for loop in loops)
    Path("text.stl").write_text(f"solid fore\n{facets_of_text}endsolid fore\n")
    places = " ".join(str(value) for corner in SIZE for value in corner)
    sides = " ".join(str(number) for side in SIDES for number in side)
    Path("fore.dae").write_text(DAE.format(places=places, sides=sides))
    rest = ROBOT[ROBOT.index("joints:") :]
    for mesh in MESHES:
        shape = f'<mesh filename="{mesh}"/>'
        Path(f"{mesh}.urdf").write_text(URDF.replace('<cylinder radius="0.05" length="0.3"/>', shape))
        Path(f"{mesh}.yaml").write_text(f"name: two-links\nmodel: {{urdf: {mesh}.urdf, mounting: table}}\n{rest}")


def _with_dbc() -> str:
    head = ROBOT[: ROBOT.index("    signals:")]
    return f"{head}    dbc: arm.dbc\n"


def _write_tables(columns: dict[str, Any]) -> None:
    names = ["t", "q1", "q2", "current1", "current2"]
    rows = np.column_stack(list(columns.values()))
    np.savetxt("run.csv", rows, delimiter=",", header=",".join(names), comments="", fmt="%.6g")
    np.savetxt("blanks.txt", rows[:100], header=" ".join(names), comments="# ", fmt="%.6g")
    np.savez("run.npz", **columns)
    np.savez_compressed("packed.npz", meta='{"units": "rad"}', **columns)
    scipy.io.savemat("run.mat", {"log": {**columns, "joints": ["shoulder", "elbow"]}})
    scipy.io.savemat("packed.mat", columns, do_compression=True)
    scipy.io.savemat("old.mat", columns, format="4")
    for name, packing in (("foreign.hdf5", {}), ("packed.hdf5", {"compression": "gzip", "chunks": True})):
        with h5py.File(name, "w") as file:
            for quantity, values in columns.items():
                file.create_dataset(f"log/{quantity}", data=values, **packing)
            file["log/joints"] = ["shoulder", "elbow"]


def _write_bags(columns: dict[str, Any]) -> None:
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    message, header, time = (
        store.types[name] for name in (JOINT_STATE, "std_msgs/msg/Header", "builtin_interfaces/msg/Time")
    )
    for target, plugin, packed in (
        ("run.db3", StoragePlugin.SQLITE3, False),
        ("run.mcap", StoragePlugin.MCAP, False),
        ("packed.mcap", StoragePlugin.MCAP, True),
    ):
        writer = Writer(Path("bag"), version=9, storage_plugin=plugin)
        if packed:
            writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        with writer:
            connection = writer.add_connection("/joint_states", JOINT_STATE, typestore=store)
            for t, q, effort in zip(columns["t"][:100], columns["q"], columns["current"], strict=False):
                stamp = round(1e9 * t) + 10**9
                head = header(stamp=time(sec=stamp // 10**9, nanosec=stamp % 10**9), frame_id="")
                content = message(head, ["shoulder", "elbow"], q.copy(), np.zeros(0), effort.copy())
                writer.write(connection, stamp, store.serialize_cdr(content, JOINT_STATE))
        Path("bag", f"bag{Path(target).suffix}").rename(target)
        Path("bag", "metadata.yaml").unlink()
        Path("bag").rmdir()


Commands = Callable[[str], list[list[str]]]

COMMANDS: dict[str, Commands] = {
    "recording": lambda file: [
        ["info", file, "--json"],
        ["identify", file, "-o", "out"],
        ["recover", file, "-o", "out.h5"],
        ["predict", "model.json", file, "-o", "out.h5"],
    ],
    "robot file": lambda file: [
        ["check", file],
        ["robot", "show", file],
        ["identify", "run.h5", "--robot", file, "-o", "out"],
        ["import", "run.csv", "--robot", file, "-o", "out.h5"],
    ],
    "URDF": lambda file: [
        ["check", file],
        ["robot", "new", file, "-o", "out.yaml"],
        ["export", "model.json", "--urdf", "out.urdf", "--into", file],
    ],
    "mesh": lambda file: [["check", f"{file}.yaml"]],
    "trajectory": lambda file: [
        *(
            [f"excite arm.yaml --from {file} --period 4 --harmonics 2 --starts 1 -o out.yaml".split()]
            * ("four" in file)
        ),
        ["record", "arm.yaml", "--trajectory", file, "--yes", "--no-ui", "-o", "out.h5"],
    ],
    "result": lambda file: [
        ["validate", file, "run.h5"],
        ["predict", file, "run.h5", "--json"],
        ["diff", file, "other.json"],
        ["merge", file, "other.json", "-o", "out"],
        ["export", file, "--urdf", "out.urdf", "--mjcf", "out.xml", "--c", "out"],
    ],
    "limits": lambda file: [["validate", "model.json", "run.h5", "--accept", file]],
    "DBC": lambda file: [["check", "dbc-arm.yaml"]],
    **dict.fromkeys(
        ("CSV", "npz", "mat", "HDF5", "db3", "MCAP"),
        lambda file: [["import", file, "--robot", "arm.yaml", "--by-order", "--effort", "current", "-o", "out.h5"]],
    ),
}
"""Kind → the command lines that read a file of it."""
