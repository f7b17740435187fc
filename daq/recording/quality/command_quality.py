"""Do measured positions follow the recorded commands? Their overlap, clocks, order, units, zeros and signs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from daq.recording.commanded_motion import TARGET, CommandedMotion
from daq.recording.quality.quantisation import resolution
from drivers.core.arrays import FloatArray, IndexArray

GRID_STEP = 0.01
"""Interval [s] at which commands and positions are compared."""

LARGEST_SHIFT = 100
"""Shifts either way that are tried, in intervals of the grid."""

MOST_INTERVALS = 30_000
"""Intervals of the grid that are compared: those where the commands move most."""

LARGEST_POSITION = 1e6
"""Positions and commands beyond it [rad or m] are damaged, and compared with nothing."""

SPAN = 20
"""Intervals over which changes are taken for the delay: they show it better than positions, which friction drags."""

LEAST_LAG, MOST_LAG = -0.025, 0.27
"""Delays [s] of a position behind its command between which a servo can be the reason."""

LEAST_MOTION = 5e-3
"""Range of a command [rad or m] from which on its joint is to move."""

SHIFTS = GRID_STEP * np.arange(-LARGEST_SHIFT, LARGEST_SHIFT + 1)
"""(2·LARGEST_SHIFT + 1,) that are tried [s]."""

POSSIBLE = (SHIFTS >= LEAST_LAG) & (SHIFTS <= MOST_LAG)
"""Those that a servo can have."""

HELD = 0.1
"""Distance [rad or m] of a joint from its command up to which friction and gravity hold it: an SO-101 sags by 0.08."""

BRIEF, UNHELD = 5.0, 0.05
"""In a recording of less than so many seconds every command is little more than a ramp, like any other's: there a joint
follows another's only where its own leaves so large a deviation [rad or m]."""

LEAST_OFFSET = 0.3
"""Median distance [rad or m] of a joint that follows its command beyond which the two have different zeros."""

LEAST_CHANGES, MOST_ROWS = 50, 3
"""Changes of the positions, and rows of shift, from and up to which they are compared with the commands' own values."""

COPY_ROUNDING = 1e-6
"""Relative difference of one value in two columns: of single precision."""

COPIED = 0.9
"""Share of the changed positions that are also commands, from which on these are measured positions."""

UNRELATED = 0.5
"""Correlation of a joint with its command at every shift below which it does not follow it."""

LEAST_STEPS = 5.0
"""The same in steps of the encoder."""

LONGEST_REST = 1.0
"""[s] No servo waits longer for its command to take effect."""

PASSED, GONE = 0.1, 0.5
"""Shares of a command's range: by which it goes to both sides of a position that rests, and of its way meanwhile, from
which on the encoder is frozen: what blocks a joint is on one side of it."""

FOLLOWING_CORRELATION = 0.8
"""Correlation of a position with a command from which on it follows it."""

DELAY_CORRELATION = 0.9
"""Correlation of the changes from which on they tell the delay."""

MISTAKE_VARIANCE = 0.3
"""Variance that another joint's command leaves, or the opposite one, over what the own one leaves, to be believed."""

CLOCK_VARIANCE = 0.8
"""Variance that the best shift leaves, over that of the best one a servo can have, below which it is believed."""


@dataclass(frozen=True)
class CommandQuality:
    """How commands and measured positions go together."""

    before: float  # time with samples before the first command [s]
    after: float  # time with samples after the last command, less a period of the commands [s]
    delay: float  # shift [s] by which the joint that follows its command most closely does so; nan where none tells
    apart: bool  # whether no delay that a servo can have explains its motion nearly as well
    ratios: dict[str, float]  # change of position over change of command, by joint; of joints that follow their command
    swapped: dict[str, str]  # joint → the joint whose command it follows instead of its own
    opposite: tuple[str, ...]  # joints that move against their command
    still: tuple[str, ...]  # joints whose position does not change although they are commanded to move
    # joint → first and last time [s] between which its position rests while its command passes it by far
    frozen: dict[str, tuple[float, float]]
    resting: tuple[str, ...]  # joints that do not move, and are not commanded to by more than `HELD`
    offsets: dict[str, float]  # joint → position less command [rad or m], of joints that follow at another zero
    copied: int | None  # rows by which the commands' values are those measured later; None where they are not
    unrelated: bool  # whether the commands are no positions: no joint follows its own, or all follow their integral


def command_quality(motion: CommandedMotion) -> CommandQuality:
    """Compare the measured with the commanded positions."""
    names, command = motion.joint_names, motion.commands[TARGET]
    period = float(np.median(np.diff(motion.command_time)))
    asked, moves = np.ptp(command, axis=0), np.ptp(motion.position, axis=0)
    steps = np.array([resolution(column) for column in motion.position.T])
    steps[~np.isfinite(steps)] = 0.0
    commanded = asked > np.maximum(LEAST_MOTION, LEAST_STEPS * steps)
    moving = moves > LEAST_STEPS * steps
    sound = np.maximum(np.abs(command).max(axis=0), np.abs(motion.position).max(axis=0)) < LARGEST_POSITION
    used = np.flatnonzero(commanded & (moves > 0.0) & sound)
    position, told_then = _on_one_grid(motion, used)
    delay, apart = _delay(position, told_then)
    correlations = _correlations(position, told_then) if position.size else np.zeros((0, 0, 0))
    ratios, swapped, opposite = _followed(position, told_then, correlations)
    frozen = {
        names[joint]: rest
        for place, joint in enumerate(used.tolist())
        # Of two exchanged joints each rests while its own command passes it, but not while the other's does.
        if (rest := _frozen(motion, joint, joint)) and _frozen(motion, joint, int(used[swapped.get(place, place)]))
    }
    offsets = np.median(motion.position - motion.held(motion.time), axis=0)
    return CommandQuality(
        before=max(0.0, float(motion.command_time[0] - motion.time[0])),
        after=max(0.0, float(motion.time[-1] - motion.command_time[-1]) - period),
        delay=delay,
        apart=apart,
        ratios={names[used[place]]: ratio for place, ratio in ratios.items()},
        swapped={names[used[place]]: names[used[other]] for place, other in swapped.items()},
        opposite=tuple(names[used[place]] for place in opposite),
        still=tuple(np.array(names)[(asked > HELD) & (moves == 0.0)].tolist()),
        frozen=frozen,
        resting=tuple(np.array(names)[(asked <= HELD) & (moves == 0.0) | ~commanded & ~moving].tolist()),
        offsets={
            names[used[place]]: float(offsets[used[place]])
            for place, ratio in ratios.items()
            if abs(offsets[used[place]]) > LEAST_OFFSET and abs(ratio - 1.0) < LEAST_OFFSET
        },
        copied=_copied(motion),
        unrelated=_unrelated(position, told_then, correlations) and not swapped and not opposite,
    )


def _unrelated(position: FloatArray, command: FloatArray, correlations: FloatArray) -> bool:
    """Whether no joint follows its command, at whatever shift, or all follow its integral instead."""
    if not position.size:
        return False
    own = np.diagonal(correlations, axis1=1, axis2=2)
    passed = np.cumsum(command[LARGEST_SHIFT:-LARGEST_SHIFT], axis=0)
    same = [np.corrcoef(column, other)[0, 1] for column, other in zip(position.T, passed.T, strict=True)]
    integral = np.maximum(own[POSSIBLE].max(axis=0), DELAY_CORRELATION) < same
    return bool(np.all(own < UNRELATED) or np.all(integral))


def _copied(motion: CommandedMotion) -> int | None:
    """Rows by which the commands' values are those measured later, joint by joint; None where no shift has them."""
    position, command = motion.position, motion.held(motion.time)
    for rows in sorted(range(-MOST_ROWS, MOST_ROWS + 1), key=abs):
        inner = slice(MOST_ROWS, len(position) - MOST_ROWS)
        measured = position[MOST_ROWS + rows : len(position) - MOST_ROWS + rows]
        changed = np.diff(measured, axis=0) != 0.0
        if np.count_nonzero(changed) >= LEAST_CHANGES:
            same = np.abs(command[inner] - measured)[1:] <= COPY_ROUNDING * np.abs(measured[1:])
            if np.mean(same[changed]) > COPIED:
                return rows
    return None


def _frozen(motion: CommandedMotion, joint: int, source: int) -> tuple[float, float] | None:
    """First and last time [s] of a joint's longest rest, if the command `source` passes it by far on both sides."""
    position, time = motion.position[:, joint], motion.time
    ends = np.concatenate([[-1], np.flatnonzero(np.diff(position) != 0.0), [len(position) - 1]])
    longest = int(np.argmax(time[ends[1:]] - time[ends[:-1] + 1]))
    first, last = int(ends[longest]) + 1, int(ends[longest + 1])
    if time[last] - time[first] < 2 * LONGEST_REST:
        return None
    settled = time[first : last + 1]
    command = motion.held(settled[settled <= time[last] - LONGEST_REST])[:, source]
    whole = float(np.ptp(motion.commands[TARGET][:, source]))
    sides = min(float(command.max()) - position[first], position[first] - float(command.min()))
    passed = sides > max(PASSED * whole, HELD) and np.ptp(command) > GONE * whole
    return (float(time[first]), float(time[last])) if passed else None


def _on_one_grid(motion: CommandedMotion, joints: IndexArray) -> tuple[FloatArray, FloatArray]:
    """Positions (K, m) at even times, and the commands (K + 2·LARGEST_SHIFT, m) in force then, before and after."""
    start, stop = motion.time[0], motion.time[-1]
    if stop - start > MOST_INTERVALS * GRID_STEP:
        way = np.abs(np.diff(motion.commands[TARGET][:, joints], axis=0)).sum(axis=1)
        passed = np.concatenate([[0.0], np.cumsum(way)])
        starts = np.clip(motion.command_time, start, stop - MOST_INTERVALS * GRID_STEP)
        ends = np.interp(starts + MOST_INTERVALS * GRID_STEP, motion.command_time, passed)
        start = float(starts[int(np.argmax(ends - np.interp(starts, motion.command_time, passed)))])
        stop = start + MOST_INTERVALS * GRID_STEP
    count = int((stop - start) / GRID_STEP) + 1
    grid = start + GRID_STEP * np.arange(-LARGEST_SHIFT, count + LARGEST_SHIFT)
    inner = grid[LARGEST_SHIFT : LARGEST_SHIFT + count]
    position = np.empty((count, len(joints)))
    for place, joint in enumerate(joints):
        position[:, place] = np.interp(inner, motion.time, motion.position[:, joint])
    return position, motion.held(grid)[:, joints]


def _correlations(position: FloatArray, command: FloatArray) -> FloatArray:
    """(2·LARGEST_SHIFT + 1, m, m) of each position with each command, by the shift of the commands."""
    position = position - position.mean(axis=0)
    size, shifts = np.linalg.norm(position, axis=0), 2 * LARGEST_SHIFT + 1
    correlation = np.zeros((shifts, position.shape[1], position.shape[1]))
    for place in range(shifts):
        start = shifts - 1 - place
        window = command[start : start + len(position)]
        window = window - window.mean(axis=0)
        norms = np.outer(size, np.linalg.norm(window, axis=0))
        np.divide(position.T @ window, norms, out=correlation[place], where=norms > 0.0)
    return correlation


def _delay(position: FloatArray, command: FloatArray) -> tuple[float, bool]:
    """The shift [s] of the joint whose changes follow its command's most closely, and whether no servo has it."""
    if len(position) <= SPAN or not position.size:
        return float("nan"), False
    changes = _correlations(position[SPAN:] - position[:-SPAN], command[SPAN:] - command[:-SPAN])
    own = np.diagonal(changes, axis1=1, axis2=2)
    closest = own[:, int(np.argmax(own.max(axis=0)))]
    if closest.max() < DELAY_CORRELATION:
        return float("nan"), False
    left = 1.0 - np.maximum(closest, 0.0) ** 2
    delay = float(SHIFTS[int(np.argmin(left))])
    return delay, not LEAST_LAG <= delay <= MOST_LAG and bool(left.min() < CLOCK_VARIANCE * left[POSSIBLE].min())


def _followed(
    position: FloatArray, command: FloatArray, correlations: FloatArray
) -> tuple[dict[int, float], dict[int, int], list[int]]:
    """Slopes of the joints that follow their commands, those that follow another's, those that move against theirs."""
    ratios: dict[int, float] = {}
    swapped: dict[int, int] = {}
    opposite: list[int] = []
    least = UNHELD if len(position) * GRID_STEP < BRIEF else 0.0
    for place in range(correlations.shape[1]):
        own, best = correlations[:, place, place], correlations[:, place, :].max(axis=0)
        other = int(np.argmax(best))
        left = np.std(position[:, place]) * np.sqrt(1.0 - min(max(best[place], 0.0), 1.0) ** 2)
        believed = np.sqrt(max(FOLLOWING_CORRELATION**2, 1.0 - MISTAKE_VARIANCE * (1.0 - max(best[place], 0.0) ** 2)))
        if other != place and best[other] > believed and left >= least:
            swapped[place] = other
        elif -own.min() > believed and left >= least:
            opposite.append(place)
        elif best[place] > FOLLOWING_CORRELATION:
            start = 2 * LARGEST_SHIFT - int(np.argmax(own))
            window = command[start : start + len(position), place]
            ratios[place] = float(best[place] * np.std(position[:, place]) / np.std(window))
    return ratios, swapped, opposite
