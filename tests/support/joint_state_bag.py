"""ROS 2 bags with joint states, for the importers' tests."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from three_links import NAMES, Arrays


def write_bag(
    folder: Path,
    arrays: Arrays,
    *,
    mcap: bool = False,
    names: Callable[[int], tuple[str, ...]] = lambda _: NAMES,
    stamped: bool = True,
    topics: tuple[str, ...] = ("/joint_states",),
    start: int = 0,
    effort: str = "torque",
    edit: Callable[[int, dict[str, Any]], None] | None = None,
) -> Path:
    """A rosbag2 folder with JointState messages and a text; `names` gives each message's joints, values follow them."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    joint_state, header, stamp, text = (
        store.types[name.replace("/", "/msg/")]
        for name in ("sensor_msgs/JointState", "std_msgs/Header", "builtin_interfaces/Time", "std_msgs/String")
    )
    path = folder / "bag"
    plugin = StoragePlugin.MCAP if mcap else StoragePlugin.SQLITE3
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        other = writer.add_connection("/chatter", text.__msgtype__, typestore=store)
        writer.write(other, start, store.serialize_cdr(text(data="hello"), text.__msgtype__))
        connections = [writer.add_connection(topic, joint_state.__msgtype__, typestore=store) for topic in topics]
        for index, time in enumerate(arrays["t"]):
            order = names(index)
            fields: dict[str, Any] = {"name": list(order)}
            for field, key in (("position", "q"), ("velocity", "qd"), ("effort", effort)):
                by_name = dict(zip(NAMES, arrays[key][index], strict=True)) if key in arrays else {}
                fields[field] = np.array([by_name.get(name, 7.0) for name in order if by_name], dtype=np.float64)
            if edit is not None:
                edit(index, fields)
            nanoseconds = start + round(float(time) * 1e9)
            seconds, rest = divmod(nanoseconds if stamped else 0, 1_000_000_000)
            message = joint_state(header=header(stamp=stamp(sec=seconds, nanosec=rest), frame_id=""), **fields)
            for connection in connections:
                writer.write(connection, nanoseconds, store.serialize_cdr(message, joint_state.__msgtype__))
    return path
