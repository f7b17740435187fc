"""A CAN bus through python-can: opening any of its interfaces, and sending (receiving: `drivers.can.receiver`).

Buses differ: socketcan and udp_multicast stamp a frame in the kernel when it arrives, others when it
is read; udp_multicast hands a sender its own frames back; slcan passes truncated lines on.
"""

from __future__ import annotations

import contextlib
import difflib
import errno
import logging
import os
import socket
import sys
import threading
from collections.abc import Mapping, Sequence
from typing import Any

import can

from drivers.core.clock import SYSTEM_CLOCK, Clock
from drivers.core.errors import ConnectionFailedError, ConnectionLostError

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

RECEIVE_BUFFER_BYTES = 4 * 2**20
"""Asked of the kernel; udp_multicast's default holds 256 frames, 21 ms of six drives at 1 kHz."""
SEND_LIMIT = 0.05
"""How long [s] a frame may wait for room in the adapter."""
EXTENDED = 0x80000000
"""Added to a 29-bit identifier, as socketcan and DBC files do; an 11-bit one stands as it is."""
REMOTE = 0x40000000
"""Added to the identifier of a remote frame (a request for so many bytes as are given), as socketcan does."""

RETURNED = {"receive_own_messages": True}
"""Option of socketcan and the virtual bus: hand sent frames back once the bus has carried them."""

Frame = tuple[float, int, bytes]
"""Arrival [s, the host's monotonic clock], identifier, data."""

_IP_MULTICAST_ALL, _IPV6_MULTICAST_ALL = 49, 29  # Linux's numbers, which the socket module lacks


def is_bus_off(message: can.Message) -> bool:
    """Return whether an error frame of socketcan says that the adapter has left the bus."""
    return bool(message.arbitration_id & _BUS_OFF)


def error_frame_words(message: can.Message) -> str:
    """Return what an error frame of socketcan says."""
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
    """Return whether an adapter met a frame that it does not understand, as opposed to being gone itself."""
    return isinstance(error, can.CanOperationError) and not isinstance(error.__cause__, OSError | type(None))


def reason(error: BaseException) -> str:
    """Return why an adapter failed: what the system said where it was the system."""
    cause = error.__cause__ or error.__context__
    system = error if isinstance(error, OSError) else cause if isinstance(cause, OSError) else None
    if system is not None and system.strerror:
        return system.strerror
    return str(error) or type(error).__name__


def why_not_opened(error: Exception, interface: str, channel: str | int) -> tuple[str, str]:
    """Return what was wrong when a bus could not be opened, and what to do about it."""
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
        return "this computer has no CAN sockets", "socketcan needs Linux with its CAN modules"
    return (
        f"cannot be opened: {reason(error)}",
        "see 'interface', 'channel', 'bitrate' and 'options' of the connection",
    )


def open_bus(interface: str, channel: str | int, bitrate: int, options: Mapping[str, object]) -> can.BusABC:
    """Open a bus of any interface that python-can knows.

    Args:
        interface: its name there: socketcan, slcan, pcan, udp_multicast, virtual, …
        channel: what the interface calls a bus: can0, a serial port, a multicast address, …
        bitrate: [bit/s]; socketcan's is set outside (ip link), and buses without wires have none.
        options: further arguments of the interface, which go before our defaults.

    Raises:
        ConnectionFailedError: says in words what is missing.
    """
    where = f"{interface} {channel}"
    keep_quiet("can")
    if interface not in can.interfaces.VALID_INTERFACES:
        interfaces = sorted(can.interfaces.VALID_INTERFACES)
        close = difflib.get_close_matches(interface, interfaces, 1)
        hint = f"did you mean '{close[0]}'?" if close else f"there are: {', '.join(interfaces)}"
        raise ConnectionFailedError(f"python-can has no interface '{interface}'", where=where, hint=hint)
    defaults: dict[str, object] = {}
    if interface == "udp_multicast":
        defaults["hop_limit"] = 0  # frames stay on this computer
    elif interface == "slcan":
        defaults["sleep_after_open"] = 0  # python-can waits 2 s for adapters that restart when they are opened
    arguments: dict[str, Any] = {"bitrate": bitrate, **defaults, **options}
    try:
        bus = can.Bus(channel=channel, interface=interface, ignore_config=True, **arguments)
    except Exception as error:  # python-can's interfaces raise whatever their manufacturers' libraries do
        message, hint = why_not_opened(error, interface, channel)
        raise ConnectionFailedError(message, where=where, hint=hint) from error
    _prepare_socket(bus)
    if bus.channel_info == "unknown":  # slcan does not say
        bus.channel_info = where
    return bus


def sends_in_kernel(bus: can.BusABC) -> bool:
    """Whether frames can be sent at a fixed period by the kernel's timer, and come back with the time of sending.

    python-can's other interfaces send from a thread of this process, or from hardware that does not report the time.
    """
    return type(bus).__name__ == "SocketcanBus"


def returns_own_frames(bus: can.BusABC) -> bool:
    """Return whether a sender receives its own frames."""
    return type(bus).__name__ == "UdpMulticastBus"


def confirms_sending(interface: str, options: Mapping[str, object]) -> bool:
    """Return whether the adapters of an interface hand a frame back once the bus has carried it.

    socketcan's do, where `open_bus` is given `RETURNED`; python-can's virtual bus where its options have that.
    """
    return interface in {"socketcan", "virtual"} and bool(options.get("receive_own_messages", interface == "socketcan"))


class Sender:
    """Sends frames from any thread, one at a time; with `fd` those of CAN FD, their data at its higher bit rate.

    Sending raises ConnectionLostError where the adapter is gone, or does not take a frame.

    Attributes:
        unconfirmed: since when frames are being sent of which none came back [s, the host's monotonic clock]; None
            where one did since, or the adapter returns none.
    """

    def __init__(self, bus: can.BusABC, clock: Clock = SYSTEM_CLOCK, *, fd: bool = False) -> None:
        self._fd = fd
        self.unconfirmed: float | None = None
        self._identifiers: set[int] = set()
        self._returned = False
        self._bus = bus
        self._clock = clock
        self._lock = threading.Lock()
        # slcan and socketcan give up at once without a limit or wait for ever; the others know none.
        self._limit = SEND_LIMIT if type(bus).__name__ in {"SocketcanBus", "slcanBus"} else None

    def send(self, identifier: int, data: bytes) -> float:
        """Send a frame, see `EXTENDED` and `REMOTE`; when that was [s, the host's monotonic clock, before sending]."""
        return self.send_all(((identifier, data),))

    def send_all(self, frames: Sequence[tuple[int, bytes]]) -> float:
        """Send frames without another thread's in between; when the first was sent."""
        messages = [
            can.Message(
                arbitration_id=identifier & ~(EXTENDED | REMOTE),
                data=None if identifier & REMOTE else data,
                dlc=len(data),
                is_extended_id=bool(identifier & EXTENDED),
                is_remote_frame=bool(identifier & REMOTE),
                is_fd=self._fd,
                bitrate_switch=self._fd,
                check=False,
            )
            for identifier, data in frames
        ]
        with self._lock:
            begun = self._clock.now()
            self._identifiers.update(identifier for identifier, _ in frames)
            if self._returned and self.unconfirmed is None and frames:
                self.unconfirmed = begun
            try:
                for message in messages:
                    self._bus.send(message, self._limit)
            except (can.CanError, OSError, ValueError) as error:
                raise self._refused(error) from error
        return begun

    def confirm(self, identifier: int) -> bool:
        """Note a frame that a program of this computer sent and the bus has carried; whether it was this one's."""
        if identifier not in self._identifiers:
            return False
        self._returned, self.unconfirmed = True, None
        return True

    def send_periodically(self, identifier: int, data: bytes, period: float) -> can.CyclicSendTaskABC:
        """Let the kernel send a frame every `period` [s] until the task is stopped (see `sends_in_kernel`)."""
        message = can.Message(arbitration_id=identifier, data=data, is_extended_id=False)
        try:
            return self._bus.send_periodic(message, period)
        except (can.CanError, OSError, ValueError) as error:
            raise self._refused(error) from error

    def _refused(self, error: Exception) -> ConnectionLostError:
        return ConnectionLostError(
            f"the CAN adapter does not accept frames: {reason(error)}",
            where=str(self._bus.channel_info),
            hint="is another device on the bus, at this bit rate, and the bus terminated?",
        )


def close_bus(bus: can.BusABC) -> None:
    """Close a bus; never raises, for an adapter that is gone cannot be closed in order."""
    with contextlib.suppress(can.CanError, OSError, ValueError, TypeError):
        bus.shutdown()


def _prepare_socket(bus: can.BusABC) -> None:
    """Enlarge the receive buffer; of multicast groups, hear the bus's own only."""
    if type(bus).__name__ not in {"SocketcanBus", "UdpMulticastBus"}:
        return
    # The options belong to the socket, which the copy of its descriptor shares.
    with socket.socket(fileno=os.dup(bus.fileno())) as shared:
        shared.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)
        if type(bus).__name__ == "UdpMulticastBus" and sys.platform == "linux":
            # By default Linux hands a socket every group that any program here has joined, on the same port.
            if shared.family == socket.AF_INET6:
                shared.setsockopt(socket.IPPROTO_IPV6, _IPV6_MULTICAST_ALL, 0)
            else:
                shared.setsockopt(socket.IPPROTO_IP, _IP_MULTICAST_ALL, 0)


def keep_quiet(library: str) -> None:
    """Silence the logs of a library: errors and notices say the same."""
    logger = logging.getLogger(library)
    if not logger.handlers:
        logger.addHandler(logging.NullHandler())
