"""`dynid sim`: builds the plant and serves it on a bus until it is interrupted."""

from __future__ import annotations

import contextlib
import gc
import json
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from types import FrameType
from typing import TYPE_CHECKING

from drivers.core.clock import SYSTEM_CLOCK, Clock
from drivers.core.errors import DynidError, UsageError, WorkError
from drivers.core.terminal import styled, visible
from drivers.declaration import SimulatedBackEnd, declared, installed_drivers, named
from sim_drivers.served import Served, SimOptions

if TYPE_CHECKING:
    from daq.robot.loader import RobotFile
    from drivers.core.arrays import FloatArray
    from sim_drivers.plant.plant import Plant


REFRESH = 0.5
"""[s] between two status lines."""
CLEAR_LINE = "\r\x1b[K"


def serve_until_interrupted(served: Served, name: str, obey: Callable[[str], None], *, live: bool) -> None:
    """Start a simulated device, report it in one JSON object on standard output, and wait for Ctrl-C or SIGTERM.

    Lines that are typed go to `obey`, which refuses them by a UsageError.

    Raises:
        ConnectionFailedError: its bus or port is not available.
        WorkError: the simulation broke down.
    """
    signal.signal(signal.SIGTERM, _interrupt)
    if hasattr(signal, "SIGTTIN"):
        # In the background reading the terminal must fail, not stop the process.
        signal.signal(signal.SIGTTIN, signal.SIG_IGN)
    shown = False
    with served:
        # A full collection takes longer than a period.
        gc.collect()
        gc.freeze()
        print(json.dumps({"ready": True, "robot": name, "pid": os.getpid(), **served.ready()}), flush=True)
        # Typed by a person: it runs in real time, whatever clock the device has.
        threading.Thread(target=_obey_typed_lines, args=(served, obey), name="faults", daemon=True).start()
        with contextlib.suppress(KeyboardInterrupt):
            while served.failure is None:
                time.sleep(REFRESH)
                while served.messages:
                    _say(served.messages.popleft(), live=shown)
                if live and _in_foreground():
                    shown = True
                    line = visible(served.live_line())
                    print(f"{CLEAR_LINE}{line}", end="", file=styled(sys.stderr), flush=True)
    if shown:
        print(file=sys.stderr)
    if isinstance(served.failure, DynidError):
        raise served.failure
    if served.failure is not None:
        raise WorkError(f"the simulation broke down: {served.failure!r}") from served.failure


def _in_foreground() -> bool:
    """Whether standard error is a terminal that no other program has: a status line would overwrite what is typed."""
    if not sys.stderr.isatty():
        return False
    try:
        return os.tcgetpgrp(sys.stderr.fileno()) == os.getpgrp()
    except (AttributeError, OSError, ValueError):  # no such thing as a foreground
        return True


def _interrupt(_number: int, _frame: FrameType | None) -> None:
    raise KeyboardInterrupt


def _obey_typed_lines(served: Served, obey: Callable[[str], None]) -> None:
    try:
        for line in sys.stdin:
            if not line.strip():
                continue
            try:
                obey(line)
            except UsageError as error:
                served.messages.append(str(error))
    except (OSError, ValueError, AttributeError):
        return  # no standard input, or not ours to read


def _say(message: str, *, live: bool) -> None:
    print(f"{CLEAR_LINE if live else ''}dynid: {visible(message)}", file=styled(sys.stderr), flush=True)


START = "start"
"""Name of the pose in which a simulated arm stands at first."""


def simulate(options: SimOptions, *, live: bool) -> None:
    """Serve a simulated arm until Ctrl-C or SIGTERM, with a status line on standard error where `live`.

    Its bus is `wire_of` its file where none is named, and it stands in the file's pose `start`, or in the middle of the
    joints' ranges, where no position is.

    Raises:
        UsageError: a bus, a version, a payload, a position or an arm that cannot be simulated, or wrong keys of a
            connection.
        RobotFileError: the robot file cannot be read, or has no truth.
        ConnectionFailedError: an address cannot be listened on, or a bus not opened.
    """
    import numpy as np

    from daq.robot.loader import load_robot
    from sim_drivers.plant.contact import CONTACT_WORDS

    if options.wire is not None:
        back_end_of(options.wire)
    robot_file = load_robot(options.robot)
    if options.payload is not None:
        from sim_drivers.plant.altered_arm import with_payload

        robot_file = with_payload(robot_file, options.payload)
    if options.position is not None:
        start: FloatArray | None = start_position(robot_file, options.position)
    else:
        start = np.array(pose) if (pose := robot_file.robot.poses.get(START)) is not None else None
    served, plant = served_arm(robot_file, options, start)

    def obey(line: str) -> None:
        if line.split()[0] in CONTACT_WORDS:
            plant.contacts.request(line)
        else:
            served.obey(line)

    serve_until_interrupted(served, robot_file.robot.name, obey, live=live)


def back_end_of(wire: str) -> SimulatedBackEnd:
    """The simulated back end that a word of `--wire` means.

    Raises:
        UsageError: no installed driver declares it.
    """
    declared_ones = {back_end.wire: back_end for back_end in _back_ends()}
    if wire not in declared_ones:
        raise UsageError(f"'{wire}' cannot be simulated", hint=f"--wire {', '.join(declared_ones)}")
    return declared_ones[wire]


def wire_of(robot_file: RobotFile) -> str:
    """The bus of an arm: that of its first connection which can be simulated, else of a back end that stands in."""
    robot = robot_file.robot
    installed = installed_drivers()
    for connection in robot.connections.values():
        if connection.driver in installed:
            for back_end in declared(connection.driver).simulated:
                if back_end.arm:
                    return back_end.wire
    turning = None if any(robot.sliding) else robot.dof
    fitting = [candidate for candidate in _back_ends() if candidate.stands_in and candidate.turning in (turning, None)]
    return min(fitting, key=lambda back_end: back_end.turning is None).wire  # one for just such arms before one for all


def _back_ends() -> list[SimulatedBackEnd]:
    """All that installed drivers declare; a package that cannot be loaded is named on standard error."""
    back_ends: list[SimulatedBackEnd] = []
    for driver in sorted(installed_drivers()):
        try:
            back_ends += declared(driver).simulated
        except UsageError as error:  # a third party's package must not take the others down
            print(f"dynid: {error}", file=sys.stderr)
    return back_ends


def start_position(robot_file: RobotFile, text: str) -> FloatArray:
    """Return where an arm stands at first: `A,B,…`, a number for each joint [rad or m].

    Raises:
        UsageError: not of that form, another number of joints, or beyond a joint's range.
    """
    import numpy as np

    joints = robot_file.robot.joints
    hint = f"--position {','.join('0' for _ in joints)}, rad or m, for {', '.join(robot_file.robot.joint_names)}"
    try:
        numbers = [float(number) for number in text.split(",")]
    except ValueError:
        raise UsageError(f"'{text}' is not a position", hint=hint) from None
    if len(numbers) != len(joints):
        raise UsageError(f"'{text}' has {len(numbers)} numbers for {len(joints)} joints", hint=hint)
    for number, joint in zip(numbers, joints, strict=True):
        least, most = joint.position
        if not least <= number <= most:
            raise UsageError(f"--position: {number:g} of {joint.name} is not within {least:g} to {most:g}", hint=hint)
    return np.array(numbers)


def served_arm(
    robot_file: RobotFile, options: SimOptions, position: FloatArray | None = None, clock: Clock = SYSTEM_CLOCK
) -> tuple[Served, Plant]:
    """A simulated arm on its bus, not started yet, and its plant.

    It stands at a `position` (n,) [rad or m] at first, in the middle of the joints' ranges where None.

    Raises:
        UsageError: a bus, a version or an arm that cannot be simulated, or wrong keys of a connection.
        RobotFileError: the robot file has no truth.
    """
    from sim_drivers.plant.plant import Plant

    back_end = back_end_of(options.wire or wire_of(robot_file))
    plant = Plant(robot_file, seed=options.seed, position=position)
    served: Served = named(back_end.serve)(robot_file, plant, options, clock)
    if options.thermometer and back_end.arm:
        for beside in filter(None, (candidate.beside for candidate in _back_ends())):
            served = named(beside)(served, robot_file, plant, options, clock)
    if options.contact is not None:
        for line in filter(str.strip, options.contact.split(";")):
            plant.contacts.request(line)
    return served, plant
