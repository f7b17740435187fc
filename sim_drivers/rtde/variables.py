"""RTDE interface of a Universal Robots controller: versions, variables and their types, recipes.

Names, types and, where known, the version that brought each variable: Universal Robots, "RTDE Guide"; the table of the
simulated server in Universal Robots' Client Library (tests/fake_rtde_server.cpp); the lists that ur_rtde 1.6.5 asks
for. The bytes of a package are those of `drivers.rtde.protocol`.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Mapping, Sequence

from drivers.core.errors import UsageError
from drivers.rtde.protocol import DATA_PACKAGE, TEXT_MESSAGE, ControlVersion, encode_package

Value = float | int | bool | Sequence[float] | Sequence[int]

JOINTS = 6
"""RTDE's vectors have six elements, whatever the arm."""

NOT_FOUND = "NOT_FOUND"
IN_USE = "IN_USE"

WARNING_LEVEL = 2

FORMATS: Mapping[str, str] = {
    "BOOL": "?",
    "UINT8": "B",
    "UINT32": "I",
    "UINT64": "Q",
    "INT32": "i",
    "DOUBLE": "d",
    "VECTOR3D": "3d",
    "VECTOR6D": "6d",
    "VECTOR6INT32": "6i",
    "VECTOR6UINT32": "6I",
}
"""RTDE type → `struct` format; all big-endian."""

SIZES: Mapping[str, int] = {
    name: 6 if name.startswith("VECTOR6") else 3 if name.startswith("VECTOR3") else 1 for name in FORMATS
}


class ControllerVersion(ControlVersion):
    """Version of a simulated controller's software; CB3 controllers are 3.x, e-Series 5.x, PolyScope X 10.x."""

    @property
    def has_dashboard(self) -> bool:
        """Return whether port 29999 is served; PolyScope X has none."""
        return self.major < 10

    def has(self, cb3: int | None, e_series: int) -> bool:
        """Return whether something that came with 3.`cb3` (None: never) and 5.`e_series` is in this version."""
        if self.major == 3:
            return cb3 is not None and self.minor >= cb3
        return self.major > 5 or self.minor >= e_series


def parse_version(text: str) -> ControllerVersion:
    """Read `5.22` or `5.22.1`.

    Raises:
        UsageError: not a version, or of no controller that exists.
    """
    match = re.fullmatch(r"(\d{1,3})\.(\d{1,3})(?:\.(\d{1,3}))?", text.strip())
    if match is None or int(match[1]) not in (3, 5, 10):
        raise UsageError(
            f"'{text}' is not a version of a UR controller", hint="such as 3.15 (CB3), 5.22, 5.23 (e-Series), 10.10"
        )
    return ControllerVersion(int(match[1]), int(match[2]), int(match[3] or 0))


def _by_type(**names: str) -> dict[str, str]:
    """Name → type, from the names of each type."""
    return {name: kind for kind, listed in names.items() for name in listed.split()}


_ALWAYS: Mapping[str, str] = _by_type(
    DOUBLE=(
        "timestamp actual_execution_time speed_scaling target_speed_fraction actual_momentum "
        "actual_main_voltage actual_robot_voltage actual_robot_current standard_analog_input0 "
        "standard_analog_input1 standard_analog_output0 standard_analog_output1 io_current "
        "euromap67_24V_voltage euromap67_24V_current tool_analog_input0 tool_analog_input1 "
        "tool_output_current tool_temperature tcp_force_scalar"
    ),
    VECTOR6D=(
        "target_q target_qd target_qdd target_current target_moment actual_q actual_qd actual_current "
        "joint_control_output actual_TCP_pose actual_TCP_speed actual_TCP_force target_TCP_pose "
        "target_TCP_speed joint_temperatures actual_joint_voltage"
    ),
    UINT64="actual_digital_input_bits actual_digital_output_bits",
    INT32="robot_mode safety_mode tool_output_voltage",
    VECTOR6INT32="joint_mode",
    VECTOR3D="actual_tool_accelerometer elbow_position elbow_velocity",
    UINT32=(
        "runtime_state robot_status_bits safety_status_bits analog_io_types euromap67_input_bits "
        "euromap67_output_bits tool_mode tool_analog_input_types script_control_line"
    ),
)

_E_SERIES: Mapping[str, str] = _by_type(
    VECTOR6D=(
        "actual_current_window actual_TCP_acceleration target_TCP_acceleration tcp_offset "
        "wrench_calc_from_currents target_base_acceleration target_base_wrench"
    ),
    UINT64="actual_configurable_digital_input_bits actual_configurable_digital_output_bits control_step",
    DOUBLE=(
        "target_execution_time actual_robot_energy_consumed actual_robot_braking_energy_dissipated "
        "joint_position_deviation_ratio collision_detection_ratio"
    ),
    INT32="encoder0_raw encoder1_raw time_scale_source",
    UINT8="tool_output_mode tool_digital_output0_mode tool_digital_output1_mode",
    VECTOR3D="target_gravity",
)
"""Variables of all e-Series versions here: real ones brought them one after the other."""

_LATER: Mapping[str, tuple[str, int | None, int]] = {  # type, since 3.?, since 5.?
    "safety_status": ("INT32", 10, 4),
    "payload": ("DOUBLE", 11, 5),
    "payload_cog": ("VECTOR3D", 11, 5),
    "payload_inertia": ("VECTOR6D", 15, 11),
    "ft_raw_wrench": ("VECTOR6D", None, 9),
    "actual_current_as_torque": ("VECTOR6D", None, 23),
}

_IO_INPUTS: Mapping[str, str] = _by_type(
    UINT32="speed_slider_mask",
    DOUBLE="speed_slider_fraction standard_analog_output_0 standard_analog_output_1",
    UINT8=(
        "standard_digital_output_mask standard_digital_output configurable_digital_output_mask "
        "configurable_digital_output tool_digital_output_mask tool_digital_output standard_analog_output_mask "
        "standard_analog_output_type"
    ),
    VECTOR6D="external_force_torque",
)

REGISTERS = 48
UPPER_REGISTERS = 24
"""Registers 24 to 47 came with 3.9 and 5.3; those below belong to PROFINET and EtherNet/IP where they are in use."""


def _registers(direction: str, version: ControllerVersion) -> dict[str, str]:
    count = REGISTERS if version.has(9, 3) else UPPER_REGISTERS
    names = {f"{direction}_int_register_{index}": "INT32" for index in range(count)}
    names |= {f"{direction}_double_register_{index}": "DOUBLE" for index in range(count)}
    names |= {f"{direction}_bit_registers{bits}": "UINT32" for bits in ("0_to_31", "32_to_63")}
    if version.has(9, 3):
        names |= {f"{direction}_bit_register_{index}": "BOOL" for index in range(64, 128)}
    return names


def output_variables(version: ControllerVersion) -> dict[str, str]:
    """Outputs of a controller of a version: name → type. Input registers can be read back."""
    later = {name: kind for name, (kind, cb3, e_series) in _LATER.items() if version.has(cb3, e_series)}
    return (
        dict(_ALWAYS)
        | (dict(_E_SERIES) if version.major > 3 else {})
        | later
        | _registers("output", version)
        | _registers("input", version)
    )


def input_variables(version: ControllerVersion) -> dict[str, str]:
    """Inputs of a controller of a version: name → type."""
    return dict(_IO_INPUTS) | _registers("input", version)


def zero(kind: str) -> Value:
    """A variable's value before its first write."""
    if SIZES[kind] > 1:
        return (0.0,) * SIZES[kind] if kind.endswith("D") else (0,) * SIZES[kind]
    return {"DOUBLE": 0.0, "BOOL": False}.get(kind, 0)


class PackageRecipe:
    """The layout of a data package, in either direction.

    Attributes:
        recipe_id: 1-255, as the client will name it.
        variables: names, in the order of the package.
    """

    def __init__(self, recipe_id: int, types: Sequence[tuple[str, str]]) -> None:
        self.recipe_id = recipe_id
        self.variables = tuple(name for name, _ in types)
        self._fields = tuple((name, SIZES[kind]) for name, kind in types)
        body = "B" + "".join(FORMATS[kind] for _, kind in types)
        self._package = struct.Struct(f">HB{body}")
        self._payload = struct.Struct(f">{body}")

    def encode(self, values: Mapping[str, Value]) -> bytes:
        """A whole data package with the values of this recipe."""
        flat: list[float] = []
        for name, size in self._fields:
            if size == 1:
                flat.append(values[name])  # type: ignore[arg-type]
            else:
                flat.extend(values[name])  # type: ignore[arg-type]
        return self._package.pack(self._package.size, DATA_PACKAGE, self.recipe_id, *flat)

    def decode(self, payload: bytes) -> dict[str, Value] | None:
        """The values that a client sent; None where their length is not this recipe's."""
        if len(payload) != self._payload.size:
            return None
        flat = self._payload.unpack(payload)[1:]
        values: dict[str, Value] = {}
        start = 0
        for name, size in self._fields:
            values[name] = flat[start] if size == 1 else flat[start : start + size]
            start += size
        return values

    @property
    def size(self) -> int:
        """Bytes of a package."""
        return self._package.size


def split_names(text: bytes) -> tuple[tuple[str, ...], bool]:
    """A recipe's variables, and whether the list ends with a comma (ur_rtde's does, UR's client's does not)."""
    names = text.decode("ascii", errors="replace")
    trailing = names.endswith(",")
    return tuple(names.removesuffix(",").split(",")), trailing


def encode_recipe_answer(kind: int, recipe_id: int, types: Sequence[str], trailing_comma: bool) -> bytes:
    """The controller's answer to a recipe; number 0 refuses it.

    The answer ends with a comma where the question did: UR's client refuses the empty type behind one.
    """
    listed = ",".join(types) + ("," if trailing_comma else "")
    return encode_package(kind, bytes([recipe_id]) + listed.encode("ascii"))


def encode_text_message(text: str, source: str = "RTDE", level: int = WARNING_LEVEL) -> bytes:
    """A message of the controller to a client."""
    message, sender = text.encode("utf-8")[:255], source.encode("utf-8")[:255]
    return encode_package(
        TEXT_MESSAGE, bytes([len(message)]) + message + bytes([len(sender)]) + sender + bytes([level])
    )
