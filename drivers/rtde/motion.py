"""Moves a Universal Robots arm through ur_rtde, or our own program where there is none, in a process of its own.

ur_rtde's constructors hold the interpreter's lock, and against a silent controller they hang for ever; in the process
that records, either would cost samples. Positions cross a pipe with the times when they were due, and the arm follows
them `DELAY` later: a stall of the recording process is not felt. One of the whole computer is not felt either by our
own program; ur_rtde's target stands still then, the arm slows down and goes on where it was.

The process stops the arm when asked to, when its parent dies or falls silent, and when the controller refuses a
command. Where the process itself is gone, or the network, the controller's watchdog ends the program.

What both ends do is written against a pipe and a worker, whatever they are: two processes in production, whose waits on
each other are the operating system's.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import struct
import sys
from collections.abc import Callable, Sequence
from functools import partial
from importlib.util import find_spec
from typing import TYPE_CHECKING, Protocol

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.child_process import leave, started_without_interrupt
from drivers.core.clock import SYSTEM_CLOCK, Clock
from drivers.core.errors import ConnectionFailedError, ConnectionLostError
from drivers.rtde.delayed_path import DelayedPath
from drivers.rtde.servo_program import LOOKAHEAD, SERVO_GAIN, ServoProgram

if TYPE_CHECKING:
    from multiprocessing.connection import Connection
    from multiprocessing.process import BaseProcess

JOINTS = 6
SERVO_DECELERATION = 10.0
"""When leaving servo mode [m/s² of the tool]; UR's default for servoStop."""
JOINT_DECELERATION = 2.0
"""Deceleration of every joint after that [rad/s²]; UR's default for stopJ."""
SILENCE_LIMIT = 0.5
"""Without a command for this long [s] after the first the process stops the arm and gives up control."""
FIRST_COMMAND_LIMIT = 30.0
"""How long [s] the first command may take: until then the controller holds the arm by itself, and the approach is
planned from where it stands."""
WATCHDOG_RATE = 1.0
"""Commands a second below which the controller itself ends the program. Its period is longer than `SILENCE_LIMIT`, so
that this process stops the arm first where it can, and longer than leaving servo mode takes, which sends nothing."""
START_LIMIT = 20.0
"""How long [s] a busy computer may take to start the process, before the time limit for taking control begins."""
STOP_LIMIT = 4.0
"""How long [s] the process may take to stop the arm before it is killed."""
BACKLOG_LIMIT = 5
"""Commands that the process may leave unanswered: a sender waits then, so that the arm is never sent far at once."""
PATIENCE = 0.2
"""How long [s] a sender waits before the process counts as hung."""

_UNCONFIRMED_STATUS = 1
_POSITION = struct.Struct(f"{1 + JOINTS}d")
"""When it is due [s, the monotonic clock of all processes], and where."""
_BEGUN, _STOP, _READY, _TAKEN, _FAILED = b"begun", b"stop", b"ready", b"taken", b"failed "


class Control(Protocol):
    """What is used of ur_rtde's RTDEControlInterface, under its names."""

    def servoJ(  # noqa: D102
        self, q: Sequence[float], speed: float, acceleration: float, time: float, lookahead: float, gain: float
    ) -> bool: ...

    def setWatchdog(self, min_frequency: float) -> bool: ...  # noqa: D102

    def kickWatchdog(self) -> bool: ...  # noqa: D102

    def servoStop(self, a: float) -> bool: ...  # noqa: D102

    def stopJ(self, a: float) -> None: ...  # noqa: D102

    def stopScript(self) -> None: ...  # noqa: D102

    def isConnected(self) -> bool: ...  # noqa: D102

    def isProgramRunning(self) -> bool: ...  # noqa: D102

    def disconnect(self) -> None: ...  # noqa: D102


ControlFactory = Callable[[str, float], Control | ServoProgram]
"""Takes control of the arm of a host, for commands at a rate [Hz]."""


def has_ur_rtde() -> bool:
    """Return whether ur_rtde is installed; there are no wheels of it from Python 3.13 on."""
    return find_spec("rtde_control") is not None


def take_control(host: str, rate: float) -> Control | ServoProgram:
    """Control of the arm of a host by ur_rtde, which hangs where the controller is silent; by our own program without.

    Raises:
        RuntimeError, OSError, DynidError: no control.
    """
    if not has_ur_rtde():
        return ServoProgram(host, rate)
    from rtde_control import RTDEControlInterface

    control: Control = RTDEControlInterface(host, rate)
    return control


def start_process(factory: ControlFactory, host: str, rate: float, timeout: float) -> tuple[Connection, BaseProcess]:
    """A process that takes control of an arm and obeys the pipe, once it runs; `factory` must be importable there."""
    # spawn: a forked child would inherit the recorder's sockets, files and locks.
    context = multiprocessing.get_context("spawn")
    pipe, far_end = context.Pipe()
    process = context.Process(target=_run, args=(far_end, factory, host, rate, timeout), name=f"motion {host}")
    with started_without_interrupt():
        process.start()
    far_end.close()
    with contextlib.suppress(EOFError, OSError):  # it ended at once, which who waits for its control learns
        if pipe.poll(START_LIMIT):
            pipe.recv_bytes()
    return pipe, process


class MotionProcess:
    """Control of one arm, taken by the constructor within `timeout` [s] and given back by `stop`.

    Commands come at a rate [Hz]; ur_rtde chooses the host's ports. `start` makes a worker, which makes the control
    interface by `factory` and obeys the pipe.

    Raises:
        ConnectionFailedError: no control of the arm within the time limit.
    """

    def __init__(
        self,
        host: str,
        rate: float,
        timeout: float,
        factory: ControlFactory = take_control,
        start: Callable[[ControlFactory, str, float, float], tuple[Connection, BaseProcess]] = start_process,
    ) -> None:
        self._host = host
        self._unanswered = 0
        self._pipe, self._process = start(factory, host, rate, timeout)
        try:
            self._wait_for_control(timeout)
        except BaseException:
            self._end(0.0)
            raise

    @property
    def pid(self) -> int | None:
        """Identifier of the process; None before it runs."""
        return self._process.pid

    def command(self, position: FloatArray, due: float) -> None:
        """Send a joint position (6,) [rad] and when it was due [s, this computer's clock]; waits while it is behind.

        Raises:
            ConnectionLostError: the process ended, hangs, or the controller refused a command.
            ValueError: not six finite numbers.
        """
        if np.shape(position) != (JOINTS,) or not np.all(np.isfinite(position)):
            raise ValueError(f"a position has {JOINTS} finite numbers, not {position}")
        try:
            while self._pipe.poll():
                self._check_answer(self._pipe.recv_bytes())
            while self._unanswered >= BACKLOG_LIMIT:
                if not self._pipe.poll(PATIENCE):
                    self._end(0.0)
                    raise ConnectionLostError(
                        f"the motion process left commands unanswered for {PATIENCE:g} s", where=self._host
                    )
                self._check_answer(self._pipe.recv_bytes())
            self._pipe.send_bytes(_POSITION.pack(due, *position))
        except (EOFError, OSError) as error:
            raise ConnectionLostError(
                f"the motion process ended with exit status {self._process.exitcode}", where=self._host
            ) from error
        self._unanswered += 1

    def stop(self) -> bool:
        """Halt the arm and end the process; never raises. Whether the process ended in order, the arm halted."""
        with contextlib.suppress(OSError):  # it is stopping the arm already, or gone
            self._pipe.send_bytes(_STOP)
        return self._end(STOP_LIMIT)

    def _wait_for_control(self, timeout: float) -> None:
        try:
            answer = self._pipe.recv_bytes() if self._pipe.poll(timeout) else None
        except (EOFError, OSError):
            answer = _FAILED + b"ur_rtde gave up"
        if answer is None:
            raise ConnectionFailedError(
                f"no control of the arm within {timeout:g} s", where=self._host, hint="is it in remote control?"
            )
        if answer != _READY:
            reason = answer.removeprefix(_FAILED).decode(errors="replace")
            self._process.join(STOP_LIMIT)  # it gives back what it had
            raise ConnectionFailedError(
                f"no control of the arm: {reason}", where=self._host, hint="is it on, and in remote control?"
            )

    def _check_answer(self, answer: bytes) -> None:
        if answer.startswith(_FAILED):
            reason = answer.removeprefix(_FAILED).decode(errors="replace")
            raise ConnectionLostError(f"the arm was stopped: {reason}", where=self._host)
        self._unanswered -= 1

    def _end(self, patience: float) -> bool:
        leave(self._process, patience)
        self._pipe.close()
        return self._process.exitcode == 0


def _run(pipe: Connection, factory: ControlFactory, host: str, rate: float, timeout: float) -> None:
    # They may reach the whole process group; the parent must decide, or the arm would not be stopped in order.
    for ignored in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT):
        signal.signal(ignored, signal.SIG_IGN)
    _keep_standard_output_clean()
    if factory is take_control:
        with contextlib.suppress(ImportError):  # which taking control says
            import rtde_control  # noqa: F401
    _say(pipe, _BEGUN)
    _die_after(timeout)
    if not obey(pipe, factory, host, rate, lambda: _die_after(0.0), SYSTEM_CLOCK):
        sys.exit(_UNCONFIRMED_STATUS)


def obey(
    pipe: Connection, factory: ControlFactory, host: str, rate: float, taken: Callable[[], None], clock: Clock
) -> bool:
    """Take control of an arm, pass on what comes through the pipe, halt the arm in the end.

    Whether it has halted, as far as it was moved. Commands come at a rate [Hz]; `taken` is called once control is had.
    """
    try:
        control = factory(host, rate)
    except Exception as error:
        _say(pipe, _FAILED + str(error).encode())
        return True
    reason: bytes | None = b"the motion process broke"
    halted = False
    try:
        watched = control.setWatchdog(WATCHDOG_RATE)
        taken()
        if watched:
            _say(pipe, _READY)
            reason = _await_first_command(pipe, control) or _follow(pipe, control, rate, clock)
        else:
            reason = b"the controller refused the watchdog"
    except Exception as error:
        reason = str(error).encode()
    finally:
        if reason is not None:
            _say(pipe, _FAILED + reason)
        halted = _halt(control)
    return halted


def _await_first_command(pipe: Connection, control: Control | ServoProgram) -> bytes | None:
    """Keep the watchdog content until there is something in the pipe (None), or say what is wrong."""
    kick_period = 0.4 / WATCHDOG_RATE
    for _ in range(round(FIRST_COMMAND_LIMIT / kick_period)):
        try:
            if pipe.poll(kick_period):
                return None
        except (EOFError, OSError):
            return b"the recording process is gone"
        if not control.kickWatchdog():
            return b"the controller's program no longer runs"
    return f"no command for {FIRST_COMMAND_LIMIT:g} s".encode()


def _follow(pipe: Connection, control: Control | ServoProgram, rate: float, clock: Clock) -> bytes | None:
    """Pass commands on, to ur_rtde every period, until asked to stop (None) or something is wrong (what)."""
    path, heard, tick = DelayedPath(rate), clock.now(), clock.now()
    step: Callable[[], bool]
    if isinstance(control, ServoProgram):  # it keeps the pace itself, and gets each command at once
        paced, step = False, partial(control.follow, path)
    else:
        paced, step = True, partial(_servo_step, control, path, rate, clock)
    while (now := clock.now()) - heard < SILENCE_LIMIT:
        tick = min(max(tick + 1.0 / rate, now), heard + SILENCE_LIMIT)
        until = tick if paced else heard + SILENCE_LIMIT
        try:
            while pipe.poll(max(until - clock.now(), 0.0)):
                heard = clock.now()
                message = pipe.recv_bytes()
                if message == _STOP:
                    return None
                due, *position = _POSITION.unpack(message)
                path.put(due, np.array(position))
                _say(pipe, _TAKEN)
                until = tick if paced else heard
        except (EOFError, OSError):
            return b"the recording process is gone"
        if not step():
            return b"the controller refused a position; its program no longer runs"
    return f"no command for {SILENCE_LIMIT:g} s".encode()


def _servo_step(control: Control, path: DelayedPath, rate: float, clock: Clock) -> bool:
    """Send ur_rtde the path's present target; whether the controller took it."""
    return control.servoJ(path.advance(clock.now()).tolist(), 0.0, 0.0, 1.0 / rate, LOOKAHEAD, SERVO_GAIN)


def _halt(control: Control | ServoProgram) -> bool:
    """Stop the arm and end the program; whether the controller confirmed the one or the other."""
    # Each on its own: an arm that has left servo mode already must still be stopped, and the script ended.
    confirmed = False
    with contextlib.suppress(Exception):
        confirmed = control.servoStop(SERVO_DECELERATION)
    with contextlib.suppress(Exception):
        control.stopJ(JOINT_DECELERATION)
    with contextlib.suppress(Exception):
        control.stopScript()
    with contextlib.suppress(Exception):
        confirmed = confirmed or (control.isConnected() and not control.isProgramRunning())
    with contextlib.suppress(Exception):
        control.disconnect()
    return confirmed


def _keep_standard_output_clean() -> None:
    """What ur_rtde prints goes to standard error: standard output belongs to the command, which may print JSON."""
    with contextlib.suppress(OSError):  # no such port
        os.dup2(2, 1)


def _die_after(seconds: float) -> None:
    # The kernel ends the process even while ur_rtde holds the interpreter's lock and the parent is gone.
    if hasattr(signal, "setitimer"):
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.setitimer(signal.ITIMER_REAL, seconds)


def _say(pipe: Connection, message: bytes) -> None:
    try:
        pipe.send_bytes(message)
    except OSError:
        return
