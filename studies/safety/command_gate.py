"""What reaches an arm through player and command gate? Stress takes 8 minutes of CPU.

    python -m studies.safety.command_gate stress [--cases N] [--seed S]   random plans, stalls, rates, restarts, buses
    … cases                           named cases: plans, sensors, clocks, stalls

`stress` and `cases` run in simulated time, with the player, the gate and each bus's own code of production: on RTDE
servoj of the simulated controller, on CiA 402 the driver's targets at SYNC, on a signal table the encoded frames; the
two CAN arms interpolate as the simulated drives do. Figures are shares of a limit. "Sender": the commands, over the
times between them. "Set-points": what the drive is given, period by period. "Arm": where its interpolation then is,
every ms. Stalls stop all of this computer, SYNC and samples, too.
"""

from __future__ import annotations

import argparse
import itertools
import multiprocessing
import os
import sys
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from daq.motion.player import MotionSequence, Player, skip_limit
from daq.motion.trajectories import FourierSeries, Motion, Pieces, PointToPoint, RestToRest, slow_move
from daq.session.command_gate import MARGIN, CommandGate
from drivers.clock_rates import COMPARING_LIMIT, ClockRates
from drivers.core.arrays import FloatArray
from drivers.core.clock import STALL_LIMIT, Clock
from drivers.core.errors import SafetyStopError
from studies.safety.gated_arms import BUSES, COUNTS, EVERY, HEARTBEAT, JOINTS, LIMITS, SETTLED, Arm, new_arm


class Inline(threading.Thread):
    """A thread that runs where it is started."""

    def start(self) -> None:
        self.run()


class World(Clock):
    """Simulated time of one player: an arm, stalls of this computer, samples, whatever is done on the way.

    Args:
        stalls: when [s after the start], how long [s].
        measure: gives the measured position of the arm's own at a time.
        period: of the samples [s].
    """

    def __init__(self, stalls: Sequence[tuple[float, float]], period: float) -> None:
        super().__init__()
        self.time = self.begun = 100.0
        self._stalls = sorted((self.begun + when, self.begun + when + length) for when, length in stalls)
        self._period = period
        self.arm: Arm
        self.gate: CommandGate | None = None
        self.player: Player | None = None
        self.measure: Callable[[float, FloatArray], FloatArray] = lambda _, position: position
        self.jump: Callable[[float], float] = lambda now: now
        self.rates, self.differ = ClockRates(), False
        self.compared, self.own_step = 0.0, 0.0
        self.stop_at = np.inf
        self._held = 0.0

    def now(self) -> float:
        return self.jump(self.time)

    def _when(self, moment: float) -> float:
        """The true time from now on at which the clock, whatever it says, shows a moment: sleeps end then."""
        if self.now() >= moment:
            return self.time
        least, most = self.time, self.time + 1e-3
        while self.jump(most) < moment:
            least, most = most, most + 2.0 * (most - self.time)
        for _ in range(30):
            middle = 0.5 * (least + most)
            least, most = (middle, most) if self.jump(middle) < moment else (least, middle)
        return most

    def free(self, moment: float) -> float:
        """When this computer runs, from a moment on."""
        for begin, end in self._stalls:
            if begin <= moment < end:
                moment = end
        return moment

    def sleep_until(self, moment: float) -> float:
        goal = self.free(self._when(moment))
        slept = goal - self.time
        if self.gate is not None and slept > 2.0 * self._period:  # samples come while the player sleeps
            for when in np.arange(self.time, goal, self._period).tolist():
                if said := self.rates.looked(self.jump(self.free(when))):
                    self.time = when
                    raise SafetyStopError(said)
        self.time = goal
        self.arm.advance(goal)
        if self.gate is not None and not self.frozen:
            self.gate.measured(self.now(), self.measure(goal, self.arm.reference))
            if not self.differ and self.player is not None and goal - self.compared >= self.own_step - 1e-9:
                self.compared = goal
                if said := self.rates.add(goal, self.now()):
                    self.differ = True
                    raise SafetyStopError(said)
        if self.player is not None:
            self._held += slept if self.player.done else 0.0
            if self._held > 0.03 or goal > self.stop_at or goal > self.begun + 60.0:
                self.player.stop(0.0)
        return max(0.0, self.now() - moment)

    frozen = False

    def sleep(self, seconds: float) -> None:
        self.sleep_until(self.now() + seconds)

    def thread(self, target: Callable[..., object], name: str, args: Sequence[object] = ()) -> threading.Thread:
        return Inline(target=self.watched(target, name), name=name, args=tuple(args))


CHANGES: dict[str, Callable[[FloatArray, float], FloatArray]] = {
    "jump": lambda q, size: q + size,
    "not a number": lambda q, size: q * np.nan,
    "2 pi added": lambda q, size: q + 2.0 * np.pi,
    "in degrees": lambda q, size: np.degrees(q),
    "joints exchanged": lambda q, size: q[::-1],
    "mirrored": lambda q, size: -q,
    "infinite": lambda q, size: q * np.inf,
    "beyond the range": lambda q, size: q + 10.0,
    "a little jump": lambda q, size: q + 1e-3 * size,
}


@dataclass(frozen=True)
class Changed:
    """A motion that changes at a time of its own for so long [s]: what no check of the plan has seen."""

    motion: Motion
    what: str
    begin: float
    length: float
    size: float

    @property
    def duration(self) -> float:
        return self.motion.duration

    def evaluate(self, time: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        position, velocity, acceleration = self.motion.evaluate(time)
        here = (time >= self.begin) & (time < self.begin + self.length)
        with np.errstate(all="ignore"):
            return np.where(here, CHANGES[self.what](position, self.size), position), velocity, acceleration

    def pieces(self) -> Pieces:
        return self.motion.pieces()


@dataclass(frozen=True)
class Case:
    """What is tried.

    Attributes:
        bus: one of `BUSES`.
        rate: of the commands [Hz].
        motion: played after a slow approach.
        honest: whether the motion keeps the limits by its making.
        stalls: of this computer, when and how long [s] after the begin.
        take: how long the driver takes for a command [s].
        slow_from: when it begins to take so long [s after the begin].
        restart: when the player is stopped and a second one begins [s]; infinite for never.
        lie: of the host's clock, from true time [s] to what it says.
        measure: of the measured position, from time [s] and the arm's own.
        frozen: whether no measured position comes after the first.
    """

    bus: str
    rate: float
    motion: Motion
    honest: bool = True
    stalls: tuple[tuple[float, float], ...] = ()
    take: float = 0.0
    slow_from: float = 0.0
    restart: float = np.inf
    lie: Callable[[float], float] = lambda now: now
    measure: Callable[[float, FloatArray], FloatArray] = lambda _, position: position
    frozen: bool = False


@dataclass
class Outcome:
    """What came of a case: the largest share of velocity, acceleration and range in each place, and why it ended.

    Attributes:
        sender: of the commands, over the times between their due times.
        moved: of the commands over 50 ms and more, by when they were sent: velocity alone.
        fed: of the simulated arm while commands come in time, and from 0.3 s after one was left out on.
        arm: of the simulated arm, all the time.
        refused: what gate or player said; empty where the motion was played to its end.
        held: how long the moving arm was left without a command at most [s].
    """

    sender: FloatArray = field(default_factory=lambda: np.zeros(3))
    moved: float = 0.0
    fed: FloatArray = field(default_factory=lambda: np.zeros(3))
    arm: FloatArray = field(default_factory=lambda: np.zeros(3))
    refused: str = ""
    held: float = 0.0
    sent: int = 0


def played(case: Case, start: FloatArray) -> Outcome:
    """Play a case from a position."""
    period = 1.0 / case.rate
    world, outcome = World(case.stalls, period), Outcome()
    world.jump, world.measure = case.lie, case.measure
    # A session compares the clocks before it moves anything.
    if case.bus == "CiA 402":  # whose samples are stamped by the SYNCs of this computer: drives time their heartbeats
        world.rates, world.own_step = ClockRates("the drives' clock"), HEARTBEAT
    for moment in (world.begun + np.arange(-COMPARING_LIMIT, 0.0, world.own_step or 0.01)).tolist():
        if said := world.rates.add(moment, case.lie(moment)):
            return Outcome(refused=said)
    world.arm = new_arm(case.bus, start, case.rate, world.time, world.free)
    goal = case.motion.evaluate(np.zeros(1))[0][:, 0]
    here = start
    parts = 2 if case.restart < np.inf else 1
    for part in range(parts):
        log: list[tuple[float, float, FloatArray]] = []

        def send(position: FloatArray, due: float, log: list[tuple[float, float, FloatArray]] = log) -> None:
            world.arm.command(due if case.bus == "CiA 402" else world.time, position)
            log.append((world.time, due, position))
            if case.take and world.time >= world.begun + case.slow_from:
                world.sleep_until(world.now() + case.take)

        world.gate = gate = CommandGate(send, lambda *_: None, LIMITS, period, world)
        gate.measured(world.now(), case.measure(world.time, here))
        world.frozen = case.frozen

        path = MotionSequence([slow_move(here, goal, JOINTS, 0.8), case.motion], case.rate)
        buffered = STALL_LIMIT if case.bus == "CiA 402" else 0.0
        world.player = player = Player(
            gate.command, path, LIMITS.acceleration, world, held=case.bus == "RTDE", buffered=buffered
        )
        world.stop_at = world.begun + case.restart if part == 0 else np.inf
        player.start()
        said = "" if player.failure is None else str(player.failure)
        if player.failure is not None and not isinstance(player.failure, SafetyStopError):
            raise player.failure
        outcome.refused = outcome.refused or said
        outcome.sent += len(log)
        ended = world.time if said or part < parts - 1 else np.inf
        judge_sender(outcome, log, period)
        world.player = None
        for _ in range(10):
            world.sleep_until(world.now() + 0.01)
        if part < parts - 1 and not said:
            here = world.arm.reference
            judge_arm(outcome, world.arm, period, log, ended)  # control is taken anew: what was aimed at before is void
            world.arm = new_arm(case.bus, here, case.rate, world.time, world.free)
        else:
            break
    judge_arm(outcome, world.arm, period, log, ended)
    return outcome


def judge_sender(outcome: Outcome, log: list[tuple[float, float, FloatArray]], period: float) -> None:
    """Shares of the limits that the commands use, computed anew from what was sent and when."""
    if not log:
        return
    sent, due, position = (np.array(column) for column in zip(*log, strict=True))
    centre, half = 0.5 * (LIMITS.lowest + LIMITS.highest), 0.5 * (LIMITS.highest - LIMITS.lowest)
    outcome.sender[2] = max(outcome.sender[2], float(np.max(np.abs(position - centre) / half)))
    step, dt = np.diff(position, axis=0), np.diff(due)
    longest = (1 + skip_limit(period)) * period + 1e-6
    velocity, before = np.zeros(len(LIMITS.joints)), period
    for index in range(len(step)):
        time = dt[index]
        if not step[index].any() and not velocity.any():
            before = period
            continue
        waited = max(time, sent[index + 1] - due[index])
        outcome.held = max(outcome.held, waited)
        if time > longest:  # it was held meanwhile
            velocity, before, time = velocity * 0.0, period, period
        now = step[index] / time
        outcome.sender[0] = max(outcome.sender[0], float(np.max(np.abs(now) / LIMITS.velocity)))
        change = np.abs(now - velocity) / (0.5 * (time + before)) / LIMITS.acceleration
        outcome.sender[1] = max(outcome.sender[1], float(np.max(change)))
        velocity, before = now, time
    later = np.searchsorted(sent, sent + 0.05)
    known = later < len(sent)
    if known.any():
        way = np.abs(position[later[known]] - position[known]) / LIMITS.velocity
        outcome.moved = max(outcome.moved, float(np.max(way / (sent[later[known]] - sent[known])[:, None])))


def judge_arm(
    outcome: Outcome, arm: Arm, period: float, sent: Sequence[tuple[float, float, FloatArray]], ended: float
) -> None:
    """Shares behind the bus, until the gate refused: after that the driver stops the arm."""
    log = [one for one in arm.log if one[0] <= ended]
    outcome.arm = np.maximum(outcome.arm, shares(log))
    begin = -np.inf
    for last, following in itertools.pairwise([*(one[0] for one in sent), np.inf]):
        if following - last > 1.5 * period:
            fed = [one for one in log if begin <= one[0] <= last + period]
            outcome.fed = np.maximum(outcome.fed, shares(fed))
            begin = following + SETTLED


def shares(log: Sequence[tuple[float, FloatArray]]) -> FloatArray:
    """Largest velocity and acceleration over `EVERY`, and range, as shares; of positions at times."""
    if len(log) < 3:
        return np.zeros(3)
    time, position = np.array([when for when, _ in log]), np.array([where for _, where in log])
    once = np.flatnonzero(np.diff(time, prepend=-np.inf) > 1e-6)
    time, position = time[once], position[once]
    centre, half = 0.5 * (LIMITS.lowest + LIMITS.highest), 0.5 * (LIMITS.highest - LIMITS.lowest)
    result = np.zeros(3)
    result[2] = float(np.max(np.abs(position - centre) / half))
    steps = max(1, round(EVERY / max(float(np.median(np.diff(time))), 1e-9))) if len(time) > 2 else 1
    if len(time) <= 2 * steps:
        return result
    velocity = (position[steps:] - position[:-steps]) / (time[steps:] - time[:-steps])[:, None]
    change = (velocity[steps:] - velocity[:-steps]) / (time[2 * steps :] - time[steps:-steps])[:, None]
    result[0] = float(np.max(np.abs(velocity) / LIMITS.velocity))
    result[1] = float(np.max(np.abs(change) / LIMITS.acceleration))
    return result


def random_case(draw: np.random.Generator) -> tuple[Case, FloatArray]:
    """A plan of any kind, well made or not, with whatever goes wrong on the way."""
    bus = BUSES[draw.integers(3)]
    rate = float(draw.choice([125.0, 500.0] if bus == "RTDE" else [100.0, 125.0, 200.0, 250.0, 500.0]))
    start = draw.uniform(-0.5, 0.5, 2) * LIMITS.highest
    honest = bool(draw.random() < 0.5)
    share = draw.uniform(0.3, 1.0) if honest else draw.uniform(0.8, 6.0)
    first = start + draw.uniform(-0.02, 0.02, 2)
    motion: Motion
    if draw.random() < 0.5:
        way = draw.uniform(-0.3, 0.3, 2)
        need = max(
            float(np.max(1.875 * np.abs(way) / LIMITS.velocity)),
            float(np.sqrt(np.max(5.7736 * np.abs(way) / LIMITS.acceleration))),
        )
        lasts = max(need / (share if share < 1.0 else np.sqrt(share)), 2e-3)
        motion = PointToPoint(np.array([first, first + way, first]), np.array([lasts, lasts * draw.uniform(1.0, 1.5)]))
    else:
        length, harmonics = draw.uniform(0.3, 0.8), 3
        sine, cosine = draw.standard_normal((2, 2, harmonics)) / np.arange(1, harmonics + 1)
        series = RestToRest(FourierSeries(length, first, sine, cosine), 1, 0.3)
        _, speed, change = series.evaluate(np.linspace(0.0, series.duration, 4000))
        scale = share / max(
            float(np.max(np.abs(speed) / LIMITS.velocity[:, None])),
            float(np.max(np.abs(change) / LIMITS.acceleration[:, None])),
        )
        motion = RestToRest(FourierSeries(length, first, scale * sine, scale * cosine), 1, 0.3)
    if not honest and draw.random() < 0.6:
        what = str(draw.choice(sorted(CHANGES)))
        begin = draw.uniform(0.0, motion.duration)
        lasts = float(draw.choice([1.0 / rate, 0.02, 10.0]))
        motion = Changed(motion, what, begin, lasts, float(draw.normal()))
    stalls = []
    if draw.random() < 0.6:
        for _ in range(draw.integers(1, 4)):
            longest = 0.25 if draw.random() < 0.9 else 3.0
            stalls.append((draw.uniform(0.0, 1.5), float(np.exp(draw.uniform(np.log(1e-3), np.log(longest))))))
    take = float(draw.choice([0.0, 2e-4, 1e-3])) if draw.random() < 0.8 else float(draw.uniform(0.0, 2.0 / rate))
    restart = float(draw.uniform(0.1, 1.5)) if draw.random() < 0.1 else np.inf
    slow_from = float(draw.uniform(0.0, 1.5)) if take > 1.0 / rate and draw.random() < 0.5 else 0.0
    return Case(bus, rate, motion, honest, tuple(stalls), take, slow_from, restart), start


ABOVE = 1.0 + MARGIN + 1e-3
"""The gate's margin, and its rounding of 1e-9 rad, which is so much of an acceleration at 500 Hz."""
ROUNDING = 2.0 / COUNTS / EVERY**2 / float(np.min(LIMITS.acceleration))
"""The largest share of the acceleration limit that rounding three positions to counts can add at the arm."""
KINDS = (("in time", 0.002), ("stalls to 10 ms", 0.0095), ("stalls to 50 ms", 0.05), ("longer stalls", np.inf))
HEADING = "| bus | this computer | cases | refused | sender: v | a | range | arm: v | a | range | with its pauses: a |"


def tried(seed: int, number: int) -> tuple[str, str, bool, Outcome]:
    """A random case: its bus, what happened to the computer, whether it is to be played to its end, what came of it."""
    case, start = random_case(np.random.default_rng([seed, number]))
    outcome = played(case, start)
    longest = max((length for _, length in case.stalls), default=0.0)
    kind = next(word for word, most in KINDS if longest <= most)
    kind = "sends last 1 to 2 periods" if case.take > 1.0 / case.rate else kind
    if max(np.max(outcome.sender), outcome.moved) > ABOVE or np.max(outcome.fed) > ABOVE:
        print(f"above: case {number} of seed {seed}, {case.bus}, {kind}: {outcome}", file=sys.stderr)
    return case.bus, kind, case.honest and longest <= 0.0095 and case.take <= 1.0 / case.rate, outcome


def stress(cases: int, seed: int, processes: int) -> None:
    """Random cases; the largest shares by bus and by what happened."""
    with multiprocessing.Pool(processes) as pool:
        summarise(pool.starmap(tried, [(seed, number) for number in range(cases)], 50))


def summarise(results: Sequence[tuple[str, str, bool, Outcome]]) -> None:
    """Print what came of random cases."""
    rows: dict[tuple[str, str], list[Outcome]] = {}
    for bus, kind, _, outcome in results:
        rows.setdefault((bus, kind), []).append(outcome)
    honest = sum(playable for _, _, playable, _ in results)
    turned_away = sum(playable and bool(outcome.refused) for _, _, playable, outcome in results)
    print(HEADING, "|---" * (HEADING.count("|") - 1) + "|", sep="\n")
    for (bus, kind), outcomes in sorted(rows.items()):
        sender, fed, arm = (
            np.max([getattr(one, name) for one in outcomes], axis=0) for name in ("sender", "fed", "arm")
        )
        sender[0] = max(sender[0], *(one.moved for one in outcomes))
        refused = sum(bool(one.refused) for one in outcomes)
        figures = " | ".join(f"{value:.3f}" for value in (*sender, *fed, arm[1]))
        print(f"| {bus} | {kind} | {len(outcomes)} | {refused} | {figures} |")
    every = [one for outcomes in rows.values() for one in outcomes]
    sent = sum(np.max(one.sender) > ABOVE or one.moved > ABOVE for one in every)
    told, rounded = (sum(np.max(one.fed) > limit for one in every) for limit in (ABOVE, ABOVE + ROUNDING))
    print(f"\n{len(results)} cases, {sum(one.sent for one in every)} commands; above {ABOVE:g}: {sent} at the sender,")
    print(
        f"{told} at the arm while commands came, {rounded} by more than its counts explain ({ABOVE + ROUNDING:.3f}); "
        f"of {honest} plans within the limits, in time, {turned_away} refused."
    )


START = np.zeros(2)
WAY = PointToPoint(np.array([[0.1, -0.1], [0.6, 0.2], [0.1, -0.1]]), np.array([0.7, 0.7]))
"""Uses 0.88 of the acceleration limits."""
FASTEST, TURN, END = 0.62, 0.93, 1.6
"""When the motion is fastest, is about to turn and about to end [s]."""


def after(when: float, change: Callable[[FloatArray], FloatArray]) -> Callable[[float, FloatArray], FloatArray]:
    """A measured position that is changed from a time [s] on."""
    return lambda now, position: change(position) if now >= 100.0 + when else position


def named_cases() -> dict[str, dict[str, Any]]:
    """Name → what differs from the undisturbed motion."""
    cases: dict[str, dict[str, Any]] = {"undisturbed": {}}
    for what in CHANGES:
        for word, length in (("for one command", 0.004), ("from then on", 9.0)):
            cases[f"plan {what} {word}"] = {"motion": Changed(WAY, what, 0.35, length, 1.0)}
    fast = PointToPoint(WAY.points, np.array([0.35, 0.35]))
    cases["plan twice as fast"] = {"motion": fast}
    cases["a piece of 1e-12 s"] = {"motion": PointToPoint(WAY.points, np.array([0.7, 1e-12]))}
    for word, when in (("approach begins", 0.02), ("motion is fastest", FASTEST), ("turn", TURN), ("end", END)):
        for length in (0.005, 0.03, 0.07, 0.3, 2.0):
            cases[f"stall of {length:g} s, {word}"] = {"stalls": ((when, length),)}
    cases["ten stalls of 8 ms"] = {"stalls": tuple((0.5 + 0.1 * index, 0.008) for index in range(10))}
    cases["ten stalls of 40 ms"] = {"stalls": tuple((0.5 + 0.1 * index, 0.04) for index in range(10))}
    cases["each command takes 1.2 periods"] = {"take": 1.2 / 200.0}
    cases["each command takes 1.2 periods, motion is fastest"] = {"take": 1.2 / 200.0, "slow_from": FASTEST}
    for ms in (7.0, 9.0):
        cases[f"each command takes {ms:g} ms"] = {"take": 1e-3 * ms}
        cases[f"each command takes {ms:g} ms, motion is fastest"] = {"take": 1e-3 * ms, "slow_from": FASTEST}
    cases["restart while the motion is fastest"] = {"restart": FASTEST}
    cases["restart in the approach"] = {"restart": 0.1}
    for word, change in (
        ("not a number", lambda q: q * np.nan),
        ("2 pi off", lambda q: q + 2.0 * np.pi),
        ("in degrees", np.degrees),
        ("of exchanged joints", lambda q: q[::-1]),
        ("running away by 0.4 rad", lambda q: q + 0.4),
        ("of another sign", np.negative),
    ):
        cases[f"measured position {word}, from the start"] = {"measure": after(-1.0, change)}
        cases[f"measured position {word}, motion is fastest"] = {"measure": after(FASTEST, change)}
    cases["no measured position after the first"] = {"frozen": True}
    cases["measured position stays what it was"] = {"measure": lambda now, position: START}
    for word, jump in (
        ("back 1 ms", -1e-3),
        ("back 0.5 s", -0.5),
        ("on 0.003 s", 0.003),
        ("on 0.01 s", 0.01),
        ("on 0.04 s", 0.04),
        ("on 0.5 s", 0.5),
    ):
        cases[f"clock jumps {word}"] = {"lie": lambda now, jump=jump: now + jump * (now > 100.0 + FASTEST)}
    cases["clock at three times the speed, from when the motion is fastest"] = {
        "lie": lambda now: now + 2.0 * max(0.0, now - 100.0 - FASTEST)
    }
    cases["clock at half speed"] = {"lie": lambda now: 0.5 * now}
    cases["clock at double speed"] = {"lie": lambda now: 2.0 * now}
    cases["clock at double speed, from when the motion is fastest"] = {
        "lie": lambda now: now + max(0.0, now - 100.0 - FASTEST)
    }
    return cases


def name_cases() -> None:
    """The named cases on each bus."""
    print("| case | " + " | ".join(BUSES) + " | ended by |", "|---" * (len(BUSES) + 2) + "|", sep="\n")
    worst = 0.0
    for name, differs in named_cases().items():
        cells, ended = [], ""
        for bus in BUSES:
            rate = 500.0 if bus == "RTDE" else 200.0
            outcome = played(Case(bus, rate, **{"motion": WAY, **differs}), START)
            most = max(float(np.max(outcome.sender)), outcome.moved)
            worst = max(worst, most)
            cells.append(f"{most:.3f} / {np.max(outcome.fed):.3f}" if outcome.sent else "nothing sent")
            ended = ended or outcome.refused
        print(f"| {name} | {' | '.join(cells)} | {ended.partition(';')[0].partition(' (')[0] or 'its end'} |")
    print(f"\n{len(named_cases())} cases on {len(BUSES)} buses, at most {worst:.3f}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("stress", "cases"))
    parser.add_argument("--cases", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--processes", type=int, default=2)
    chosen = parser.parse_args()
    if chosen.what == "stress":
        stress(chosen.cases, chosen.seed, chosen.processes)
    else:
        name_cases()
