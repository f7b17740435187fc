"""A simulated arm behind the ports of a Universal Robots controller: RTDE, dashboard, script, secondary interface.

One thread does everything. Each period, at absolute times, the controller makes one step and every RTDE client gets
its data package; between periods the sockets are read and written without ever waiting for one of them. When the
machine stalls, the periods that were missed are made up for; after a long stall virtual time falls behind the clock
instead, so that the timestamps never have a gap that the arm did not have.
"""

from __future__ import annotations

import ipaddress
import socket
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from queue import SimpleQueue
from typing import Literal

from daq.robot.arm_lengths import arm_lengths
from daq.robot.loader import RobotFile
from daq.robot.schema import JointLimits
from drivers.core.clock import SYSTEM_CLOCK, Clock, HasFileno
from drivers.core.errors import ConnectionFailedError, ConnectionLostError, UsageError
from sim_drivers.faults import Fault
from sim_drivers.plant.plant import Plant
from sim_drivers.rtde.control_script import ScriptSession
from sim_drivers.rtde.controller import Controller
from sim_drivers.rtde.dashboard import DashboardSession, SecondarySession
from sim_drivers.rtde.session import ClientConnection, RtdeSession, Session
from sim_drivers.rtde.variables import JOINTS, parse_version
from sim_drivers.served import SimOptions
from sim_drivers.server import LONGEST_LAG, FaultyServer, with_troubles

MAXIMUM_CONNECTIONS = 64
SELECTABLE_DESCRIPTORS = 1024
SEND_BUFFER = 65536


@dataclass(frozen=True)
class Ports:
    """Ports to listen on; 0 is any free port, None none. Clients such as ur_rtde use only these."""

    rtde: int | None = 30004
    dashboard: int | None = 29999
    script: int | None = 30003
    secondary: int | None = 30002


Service = Literal["rtde", "dashboard", "script", "secondary"]
"""The protocol of a port."""


@dataclass
class ServerStatus:
    """Counters of the server."""

    time: float  # of the controller [s]
    rtde_clients: int = 0  # connected to the RTDE port now
    packages: int = 0  # data packages sent
    faulted: int = 0  # data packages withheld by faults
    overflowed: int = 0  # clients dropped because they did not read
    broken: int = 0  # clients dropped because they did not follow the protocol
    refused: int = 0  # connections beyond the server's capacity
    stalls: int = 0  # times when virtual time fell behind the clock
    safety_mode: int = 1  # 1 normal, 3 protective stop
    playing: bool = False  # whether the control script runs


class RtdeServer(FaultyServer):
    """A simulated controller; `start` listens, `stop` closes.

    Args:
        plant: the arm.
        host: address to listen on; for several arms 127.0.0.2, 127.0.0.3, ….
        version: of the controller's software, such as 5.22.
        rate: of its loop [Hz]; the version's (125 for 3.x, else 500) where None.
        joints: limits of the six joints; a UR's where None.
        ports: where to listen.
        buffer_limit: bytes that may wait for a client that does not read, before it is dropped.
        clock: the host's.

    Raises:
        UsageError: a version that does not exist, a rate that it has not, or an arm without six joints.
    """

    def __init__(
        self,
        plant: Plant,
        host: str = "127.0.0.1",
        version: str = "5.22",
        rate: float | None = None,
        *,
        joints: Sequence[JointLimits] | None = None,
        ports: Ports = Ports(),  # frozen
        buffer_limit: int = 1 << 20,
        clock: Clock = SYSTEM_CLOCK,
    ) -> None:
        names = (
            [f"j{joint_number}" for joint_number in range(1, JOINTS + 1)]
            if joints is None
            else [joint.name for joint in joints]
        )
        super().__init__("UR controller", names, clock)
        self.version = parse_version(version)
        self.rate = self.version.maximum_rate if rate is None else rate
        if not 1.0 <= self.rate <= self.version.maximum_rate:
            raise UsageError(f"version {version} runs at up to {self.version.maximum_rate:g} Hz, not {self.rate:g}")
        self.host = host
        self.ports = ports
        self.controller = Controller(plant, self.version, 1.0 / self.rate, joints)
        self.messages = self.controller.messages
        self._buffer_limit = buffer_limit
        owners: dict[str, RtdeSession] = {}
        self._sessions: Mapping[Service, Callable[[], Session]] = {
            "rtde": lambda: RtdeSession(self.controller, owners),
            "script": lambda: ScriptSession(self.controller),
            "dashboard": lambda: DashboardSession(self.controller),
            "secondary": lambda: SecondarySession(self.controller),
        }
        self._listeners: dict[HasFileno, tuple[socket.socket, Service]] = {}
        self._arrived: SimpleQueue[tuple[socket.socket, Service]] = SimpleQueue()
        self._connections: list[ClientConnection] = []
        self._frozen_until = 0.0
        self._status = ServerStatus(plant.time)

    def _open(self) -> None:
        """Listen; `ports` then holds the ports in use."""
        ports = self.ports
        rtde = self._listen(ports.rtde, "rtde")
        script = self._listen(ports.script, "script")
        dashboard = self._listen(ports.dashboard if self.version.has_dashboard else None, "dashboard")
        self.ports = Ports(rtde, dashboard, script, self._listen(ports.secondary, "secondary"))
        if not _is_loopback(self.host):
            self.messages.append(f"{self.host} can be reached from the network; any computer there can move this arm")

    def serve(self, sock: socket.socket, service: Service) -> None:
        """Serve a client that is connected already, from the next period on; may be called from any thread."""
        self._arrived.put((sock, service))

    def status(self) -> ServerStatus:
        """Counters of the server."""
        return replace(self._status)

    def ready(self) -> dict[str, object]:
        """Address for clients."""
        return {
            "host": self.host,
            "version": str(self.version),
            "rate_hz": self.rate,
            "rtde_port": self.ports.rtde,
            "dashboard_port": self.ports.dashboard if self.version.has_dashboard else None,
            "script_port": self.ports.script,
            "secondary_port": self.ports.secondary,
        }

    def live_line(self) -> str:
        """Return its state in one line."""
        status = self._status
        state = "protective stop" if status.safety_mode != 1 else "program running" if status.playing else "idle"
        line = f"{self.host} {status.time:8.1f} s  {state}, {status.rtde_clients} clients, {status.packages} packages"
        return with_troubles(line, withheld=status.faulted, overflowed=status.overflowed, stalls=status.stalls)

    def _listen(self, port: int | None, service: Service) -> int | None:
        if port is None:
            return None
        try:
            listener = socket.create_server((self.host, port))
        except OSError as error:
            raise ConnectionFailedError(
                f"cannot listen on port {port}: {(error.strerror or str(error)).partition(' (while')[0]}",
                where=self.host,
                hint="is another simulated arm running? Use --host 127.0.0.2, 127.0.0.3, …",
            ) from error
        listener.setblocking(False)
        self._listeners[listener] = listener, service
        return int(listener.getsockname()[1])

    def _work(self) -> Mapping[str, Callable[[], None]]:
        return {"rtde-server": self._serve}

    def _serve(self) -> None:
        period = 1.0 / self.rate
        begun, count = self._clock.now(), 0
        while not self._stopping.is_set():
            due = begun + count * period
            self._attend(0.0)
            while (left := due - self._clock.now()) > 0.0:
                self._attend(left)
            self._period(behind=self._clock.now() - due > period)
            count += 1
            if self._clock.now() - (begun + count * period) > LONGEST_LAG:
                begun, count = self._clock.now(), 0
                self._status.stalls += 1

    def _period(self, *, behind: bool) -> None:
        for fault in self._new_faults():
            self._cause(fault)
        for connection in self._connections:
            if isinstance(connection.session, RtdeSession):
                connection.session.apply_inputs(behind=behind)
        started = self._clock.now()
        self.controller.step()
        self.controller.values["actual_execution_time"] = 1e3 * (self._clock.now() - started)
        silent = self._clock.now() < self._frozen_until
        clients = sent = withheld = 0
        for connection in self._connections:
            if isinstance(connection.session, RtdeSession):
                clients += 1
                package = connection.session.data_package()
                if not package:
                    continue
                if silent or connection.session.withhold:
                    connection.session.withhold = max(0, connection.session.withhold - 1)
                    withheld += 1
                else:
                    connection.send(package)
                    sent += 1
        self._forget_closed()
        status = self._status
        status.time, status.rtde_clients = self.controller.arm.time, clients
        status.packages += sent
        status.faulted += withheld
        status.safety_mode, status.playing = self.controller.safety_mode, self.controller.script is not None

    def _cause(self, fault: Fault) -> None:  # noqa: C901, PLR0912 — a branch per kind of fault
        match fault:
            case Fault("drop", (count,)):
                for connection in self._connections:
                    if isinstance(connection.session, RtdeSession):
                        connection.session.withhold += count
            case Fault("freeze", (duration,)):
                self._frozen_until = self._clock.now() + duration
            case Fault("cut", ()):
                for connection in self._connections:
                    if isinstance(connection.session, RtdeSession):
                        connection.close()
            case Fault("protective-stop", ()):
                self.controller.protective_stop("on request")
            case Fault("local-control", ()):
                self.controller.remote_control = False
            case Fault("heat", (joint, celsius)):
                self.controller.arm.heat(joint, celsius)
            case Fault("block", (joint,)):
                self.controller.arm.block(joint)
            case Fault("stick", (quantity, joint)):
                self.controller.arm.stick(joint, quantity)
            case Fault("refuse", (variable,)):
                self.controller.refused.add(variable)
            case Fault("clock-jump", (seconds,)):
                self.controller.clock_ahead += seconds
            case Fault("drift", (joint, velocity)):
                self.controller.drift(joint, velocity)
            case _:
                self._not_caused(fault)

    def _attend(self, timeout: float) -> None:
        """Read and write where sockets are ready, waiting for them at most `timeout` [s]."""
        if self._clock.now() < self._frozen_until:
            # Unread and unanswered, as on a line that has gone dead.
            self._clock.sleep(timeout)
            return
        while not self._arrived.empty():
            self._take_on(*self._arrived.get())
        by_socket: dict[HasFileno, ClientConnection] = {connection.sock: connection for connection in self._connections}
        writers = [connection.sock for connection in self._connections if connection.has_waiting]
        readable, writable = self._clock.select([*self._listeners, *by_socket], writers, timeout)
        for sock in writable:
            by_socket[sock].flush()
        for sock in readable:
            if sock in self._listeners:
                self._accept(*self._listeners[sock])
            else:
                self._read(by_socket[sock])
        if readable or writable:
            self._forget_closed()

    def _accept(self, listener: socket.socket, service: Service) -> None:
        try:
            sock, _ = listener.accept()
        except OSError:
            return
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
        self._take_on(sock, service)

    def _take_on(self, sock: socket.socket, service: Service) -> None:
        if len(self._connections) >= MAXIMUM_CONNECTIONS or sock.fileno() >= SELECTABLE_DESCRIPTORS:
            sock.close()
            self._status.refused += 1
            return
        connection = ClientConnection(sock, self._sessions[service](), self._buffer_limit)
        self._connections.append(connection)
        connection.send(connection.session.greeting())

    def _read(self, connection: ClientConnection) -> None:
        chunk = connection.read() if connection.open else b""
        if not chunk:
            return
        try:
            answer = connection.session.receive(chunk)
        except ConnectionLostError as error:
            self.controller.messages.append(f"a client was dropped: {error.message}")
            self._status.broken += 1
            connection.close()
            return
        connection.send(answer)
        if connection.session.closing:
            connection.close()

    def _forget_closed(self) -> None:
        if all(connection.open for connection in self._connections):
            return
        self._status.overflowed += sum(connection.overflowed for connection in self._connections)
        self._connections = [connection for connection in self._connections if connection.open]

    def _close(self) -> None:
        for connection in self._connections:
            connection.close()
        for listener, _ in self._listeners.values():
            listener.close()
        while not self._arrived.empty():
            self._arrived.get()[0].close()
        self._connections, self._listeners = [], {}


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def serve(robot_file: RobotFile, plant: Plant, options: SimOptions, clock: Clock) -> RtdeServer:
    """A controller of the version that is asked for, which knows the arm's lengths."""
    server = RtdeServer(plant, host=options.host, version=options.version, joints=robot_file.robot.joints, clock=clock)
    if (lengths := arm_lengths(robot_file)) is not None:
        server.controller.lengths = lengths.tolist()
    return server
