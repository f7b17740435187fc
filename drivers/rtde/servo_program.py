"""Moves a Universal Robots arm by a program of our own, where ur_rtde has no wheel: Python 3.13 and later.

The program is uploaded to the script port and reads positions from RTDE input registers (Universal Robots, "RTDE
Guide" and "The URScript Programming Language": `servoj`, `stopj`, `read_input_float_register`). Registers 24 to 47 are
those meant for external clients; 0 to 23 belong to field buses. A counter in one of them is the sign of life: where it
stands still for longer than the watchdog allows, the program stops the arm and ends, whatever became of this computer.

Each write tells the path of the last 0.09 s, of which the program plays what was due 0.06 s ago: it goes on through a
stall of the computer that sends (`drivers.rtde.delayed_path`).

What ends the program otherwise (a protective stop, the pendant) shows in the controller's own `runtime_state`.
"""

from __future__ import annotations

import itertools
import struct
from collections import deque
from collections.abc import Callable

from drivers.core.clock import SYSTEM_CLOCK, Clock
from drivers.core.errors import ConnectionFailedError
from drivers.rtde import protocol as wire
from drivers.rtde.delayed_path import KNOTS, PULL, DelayedPath, knot_distance
from drivers.rtde.modes import RUNTIME_PLAYING
from drivers.rtde.protocol import Connect, connect_tcp

SCRIPT_PORT = 30003
NAME = "dynid_servo"
HOLD, SERVO, STOP = 0, 1, 2
"""What the program is asked to do: hold the arm, follow positions, stop it and end."""
ANSWER_LIMIT = 5.0
"""How long [s] the controller may take to answer, or to start the program."""
DECELERATION = 5.0
"""Deceleration of the leading joint at a stop [rad/s²]."""
STOPPING_LIMIT = 3.0
"""How long [s] the arm may take to come to rest."""
LOOKAHEAD = 0.1
"""Smoothing of the commanded path [s], 0.03 to 0.2."""
SERVO_GAIN = 300.0
"""Stiffness of the path following, 100 to 2000; UR's own default."""
_JOINTS = 6
_INTEGERS = tuple(f"input_int_register_{n}" for n in range(24, 28))
_DOUBLES = tuple(f"input_double_register_{n}" for n in range(24, 24 + KNOTS * _JOINTS))
_OUTPUTS = (("output_int_register_24", "INT32"), ("runtime_state", "UINT32"))
_VALUES = struct.Struct(f">{len(_INTEGERS)}i{len(_DOUBLES)}d")

_TARGET = ", ".join(
    "+".join(f"{weight}*read_input_float_register({24 + _JOINTS * n + joint})" for n, weight in enumerate("abcd"))
    for joint in range(_JOINTS)
)
PROGRAM = f"""def {NAME}():
  # Integers 24: counter, 25: what to do, 26: number of the newest position, 27: longest silence [ms].
  # Floats 24 to 29: that position [rad], 30 to 35: the one KNOT numbers before it, 36 to 41 and 42 to 47: and so on.
  write_output_integer_register(24, RUN)
  silence = 0.0
  count = read_input_integer_register(24)
  newest = 0
  behind = 2.0*KNOT
  todo = {HOLD}
  while todo != {STOP}:
    todo = read_input_integer_register(25)
    if read_input_integer_register(24) == count:
      silence = silence + get_steptime()
      if silence > 0.001*read_input_integer_register(27):
        textmsg("dynid: no command, the arm is stopped")
        todo = {STOP}
      end
    else:
      count = read_input_integer_register(24)
      silence = 0.0
    end
    if todo == {SERVO}:
      pace = 1.0 + {PULL:g}*(behind/KNOT - 2.0)
      if pace > 4.0*behind/KNOT:
        pace = 4.0*behind/KNOT
      end
      behind = behind - pace + read_input_integer_register(26) - newest
      newest = read_input_integer_register(26)
      if behind > 3.0*KNOT:
        behind = 3.0*KNOT
      end
      x = behind/KNOT
      a = (1.0 - x)*(2.0 - x)*(3.0 - x)/6.0
      b = x*(2.0 - x)*(3.0 - x)/2.0
      c = x*(x - 1.0)*(3.0 - x)/2.0
      d = x*(x - 1.0)*(x - 2.0)/6.0
      q = [{_TARGET}]
      servoj(q, 0, 0, get_steptime(), {LOOKAHEAD:g}, {SERVO_GAIN:g})
    elif todo == {HOLD}:
      sync()
    end
  end
  stopj({DECELERATION:g})
  write_output_integer_register(24, -RUN)
end
"""
"""URScript; RUN stands for a number of this run: what an earlier run left in the register is no answer. KNOT is how
many positions the knots of the path are apart."""


class ServoProgram:
    """Control of an arm by `PROGRAM`; but for `follow` under the names of ur_rtde's RTDEControlInterface.

    Commands come at a rate [Hz]; `connect` reaches the ports of the controller.

    Raises:
        ConnectionFailedError: the controller does not answer, another client has the registers, or the program does
            not start.
        OSError: a port cannot be reached.
    """

    def __init__(self, host: str, rate: float, connect: Connect = connect_tcp, clock: Clock = SYSTEM_CLOCK) -> None:
        self._host, self._clock = host, clock
        self._splitter = wire.PackageSplitter()
        self._packages: deque[wire.Package] = deque()
        self._counter = itertools.count(1)
        self._path = [0.0] * len(_DOUBLES)
        self._tick, self._longest_silence = 0, ANSWER_LIMIT
        self._state, self._playing, self._connected = 0, False, True
        self._run = int(clock.time_of_day() * 1e3) % (1 << 30) + 1
        self._socket = connect(host, wire.PORT, ANSWER_LIMIT)
        try:
            self._negotiate(rate)
            self._write(HOLD)
            text = PROGRAM.replace("RUN", str(self._run)).replace("KNOT", str(knot_distance(rate)))
            with connect(host, SCRIPT_PORT, ANSWER_LIMIT) as script:
                script.sendall(text.encode("ascii"))
                self._until(lambda: self._state == self._run, ANSWER_LIMIT)
            if self._state != self._run:
                raise self._failed("its program did not start", "is it on, and in remote control?")
        except BaseException:
            self.disconnect()
            raise

    def follow(self, path: DelayedPath) -> bool:
        """Let the arm follow a path at the rate of the commands, `DELAY` behind; whether the program still runs."""
        self._tick, self._path = path.tick, [value for knot in path.knots() for value in knot]
        self._write(SERVO)
        return self.isProgramRunning()

    def setWatchdog(self, min_frequency: float) -> bool:  # noqa: D102
        self._longest_silence = 1.0 / min_frequency
        return self.kickWatchdog()

    def kickWatchdog(self) -> bool:  # noqa: D102
        self._write(HOLD)
        return self.isProgramRunning()

    def servoStop(self, a: float) -> bool:
        """Stop the joints by `DECELERATION`, whatever the tool's `a` [m/s²], and end the program; whether it did."""
        self._write(STOP)
        self._until(lambda: self._state != self._run, STOPPING_LIMIT)
        return self._connected and self._state == -self._run

    def stopJ(self, a: float) -> None:
        """Nothing: the program has stopped the joints before it ended."""

    def stopScript(self) -> None:
        """Nothing: the program ends by itself, as soon as the arm stands."""

    def isConnected(self) -> bool:  # noqa: D102
        self._read(0.0)
        return self._connected

    def isProgramRunning(self) -> bool:  # noqa: D102
        self._read(0.0)
        return self._connected and self._playing and self._state == self._run

    def disconnect(self) -> None:  # noqa: D102
        self._connected = False
        self._socket.close()

    def _negotiate(self, rate: float) -> None:
        if not wire.decode_accepted(self._ask(wire.encode_protocol_request())):
            raise self._failed("it does not speak RTDE version 2", "check its software version")
        inputs = (*_INTEGERS, *_DOUBLES)
        payload = self._ask(wire.encode_package(wire.SETUP_INPUTS, ",".join(inputs).encode("ascii")))
        self._inputs, types = payload[0] if payload else 0, payload[1:].decode("ascii", errors="replace")
        if self._inputs == 0:
            reason = "another client has" if "IN_USE" in types else "it lacks"
            raise self._failed(
                f"{reason} the RTDE input registers 24 to 47", "end the other program; software from 5.3 on"
            )
        names = [name for name, _ in _OUTPUTS]
        answer = wire.decode_recipe_answer(self._ask(wire.encode_output_recipe(names, rate)), names)
        if answer.number == 0:
            raise self._failed("it lacks output register 24", "software from 5.3 on has it")
        self._recipe = wire.Recipe(answer.number, _OUTPUTS)
        if not wire.decode_accepted(self._ask(wire.encode_package(wire.START))):
            raise self._failed("RTDE did not start", "is another program using it?")

    def _ask(self, package: bytes) -> bytes:
        """The payload of the answer to a package."""
        kind = package[2]
        self._socket.sendall(package)
        deadline = self._clock.now() + ANSWER_LIMIT
        while self._connected and self._clock.now() < deadline:
            self._receive(deadline - self._clock.now())
            while self._packages:
                answer = self._packages.popleft()
                if answer.kind == kind:
                    return answer.payload
        raise self._failed(f"no answer within {ANSWER_LIMIT:g} s", "is this the arm's controller?")

    def _write(self, todo: int) -> None:
        silence = round(1e3 * self._longest_silence)
        payload = bytes([self._inputs]) + _VALUES.pack(next(self._counter), todo, self._tick, silence, *self._path)
        try:
            self._socket.sendall(wire.encode_package(wire.DATA_PACKAGE, payload))
        except OSError:
            self._connected = False

    def _until(self, reached: Callable[[], bool], seconds: float) -> None:
        """Wait until the program's state is reached, the connection is lost, or the time is over."""
        deadline = self._clock.now() + seconds
        self._read(0.0)
        while self._connected and not reached() and self._clock.now() < deadline:
            self._read(deadline - self._clock.now())

    def _read(self, seconds: float) -> None:
        """Take in what came within so many seconds."""
        self._receive(seconds)
        newest = None
        while self._packages:
            package = self._packages.popleft()
            newest = package if package.kind == wire.DATA_PACKAGE else newest
        if newest is not None:
            row = wire.decode_data(self._recipe, newest.raw)[0]
            self._state, self._playing = int(row["output_int_register_24"]), row["runtime_state"] == RUNTIME_PLAYING

    def _receive(self, seconds: float) -> None:
        while self._connected and self._clock.select([self._socket], [], max(seconds, 0.0))[0]:
            seconds = 0.0
            try:
                chunk = self._socket.recv(1 << 16)
            except OSError:
                chunk = b""
            self._connected = bool(chunk)
            self._packages += self._splitter.feed(chunk)

    def _failed(self, reason: str, hint: str) -> ConnectionFailedError:
        return ConnectionFailedError(reason, where=self._host, hint=hint)
