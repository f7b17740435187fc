"""What a CAN adapter, the system under it, or an error frame has to say, in words."""

from __future__ import annotations

import errno
from collections.abc import Mapping

import can

# Error frames as Linux delivers them (include/uapi/linux/can/error.h): bit of the identifier → meaning.
_BUS_OFF, _CONTROLLER, _NO_ACKNOWLEDGE, _BUS_ERROR = 0x40, 0x04, 0x20, 0x80
_CONTROLLER_TROUBLES: Mapping[int, str] = {
    0x01: "receive overflow",
    0x02: "send overflow",
    0x04: "receive error warning",
    0x08: "send error warning",
    0x10: "error passive (receiving)",
    0x20: "error passive (sending)",
}


def is_bus_off(message: can.Message) -> bool:
    """Whether an error frame of socketcan says that the adapter has left the bus."""
    return bool(message.arbitration_id & _BUS_OFF)


def error_frame_words(message: can.Message) -> str:
    """What an error frame of socketcan says."""
    kind, data = message.arbitration_id, bytes(message.data)
    if kind & _CONTROLLER and len(data) > 1:
        words = [text for bit, text in _CONTROLLER_TROUBLES.items() if data[1] & bit]
        return ", ".join(words) or "controller"
    if kind & _NO_ACKNOWLEDGE:
        return "no acknowledgement"
    if kind & _BUS_ERROR:
        return "bus error"
    return ""


def is_unreadable(error: Exception) -> bool:
    """Whether an adapter met a frame that it does not understand, as opposed to being gone itself."""
    return isinstance(error, can.CanOperationError) and not isinstance(error.__cause__, OSError | type(None))


def reason(error: BaseException) -> str:
    """Why an adapter failed: what the system said where it was the system."""
    cause = error.__cause__ or error.__context__
    system = error if isinstance(error, OSError) else cause if isinstance(cause, OSError) else None
    if system is not None and system.strerror:
        return system.strerror
    return str(error) or type(error).__name__


def why_not_opened(error: Exception, interface: str, channel: str | int) -> tuple[str, str]:
    """What was wrong when a bus could not be opened, and what to do about it."""
    cause = error if isinstance(error, OSError) else error.__cause__ or error.__context__
    number = cause.errno if isinstance(cause, OSError) else None
    if isinstance(error, can.CanInterfaceNotImplementedError | ImportError):
        return f"interface '{interface}' cannot be used here: {error}", "is its manufacturer's driver installed?"
    if isinstance(error, TypeError):
        return f"interface '{interface}' does not take these options: {error}", "see 'options' of the connection"
    if number in (errno.EACCES, errno.EPERM) or "ermission denied" in str(error):
        return (
            f"no permission to open {channel}",
            "a serial adapter needs membership of the group that owns it (dialout)",
        )
    if number == errno.EBUSY or "exclusively lock" in str(error):
        return f"{channel} is in use by another program", "close that program"
    if interface == "udp_multicast" and number in (errno.ENODEV, errno.ENETUNREACH):
        return "no route for multicast", "sudo ip route add 239.0.0.0/8 dev lo"
    if number in (errno.ENODEV, errno.ENOENT, errno.ENXIO):
        hint = f"sudo ip link set {channel} up type can bitrate …" if interface == "socketcan" else "is it plugged in?"
        return f"there is no channel '{channel}'", hint
    if number == errno.ENETDOWN:
        return f"{channel} is down", f"sudo ip link set {channel} up type can bitrate …"
    if number == errno.EAFNOSUPPORT:
        return "this computer knows no CAN sockets", "socketcan needs Linux with its CAN modules"
    return (
        f"cannot be opened: {reason(error)}",
        "see 'interface', 'channel', 'bitrate' and 'options' of the connection",
    )
