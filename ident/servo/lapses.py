"""Times at which a servo arm does not follow its recorded commands, in words: at a limit, at rest, late, or not asked.

A servo model holds for none of them, and its intervals do not cover what they bias. No model is needed to see them.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator

import numpy as np

from daq.recording.commanded_motion import TARGET, CommandedMotion
from daq.recording.quality.command_quality import HELD, LONGEST_REST
from daq.recording.quality.quantisation import resolution
from drivers.core.arrays import FloatArray, true_runs

SHORTEST_REST = 2.0
"""[s] of a position that rests while its command moves."""

FAR = 0.2
"""[rad or m] by which a command moves during such a rest, or is beyond the end of a joint's positions: twice as far as
friction and gravity hold a joint from its command."""

AT_END = 2.0
"""Encoder steps from the end of a joint's positions that count as at it."""

SHORTEST_HOLD, USUAL = 0.1, 5
"""[s] of commands that stand still, and samples before and after during which each one is new."""

HOLD_JUMP = 5.0
"""Change of a command after standing still, over its median change per sample before and after."""

WINDOW = 3.0
"""[s] of motion in which commands and positions are shifted against each other."""

MOST_DRIFT, MOST_LAG, SHIFT = 0.015, 0.4, 0.02
"""Drift between clocks that is looked for, either way; delays that a servo may have, and steps of both [s]."""

LEAST_DRIFT, LEFT = 0.15, 0.65
"""[s] Drift that is named, and the share at most of what is left of the positions without it."""


def lapses(motion: CommandedMotion, resting: Collection[str] = ()) -> list[str]:
    """Return each lapse of a recording in a sentence with joint and time; not that the joints `resting` do so."""
    command = motion.held(motion.time)
    found: list[str] = []
    for joint, name in enumerate(motion.joint_names):
        found += [] if name in resting else _rests(name, motion.time, motion.position[:, joint], command[:, joint])
        found += _ends(name, motion.time, motion.position[:, joint], command[:, joint])
    return [*found, *_drift(motion), *_holds(motion)]


def _rests(name: str, time: FloatArray, position: FloatArray, command: FloatArray) -> Iterator[str]:
    """The longest rest of a position (N,) whose command (N,) moves far meanwhile."""
    for first, last in true_runs(np.diff(position) == 0.0):
        since, until = float(time[first]), float(time[last])
        if until - since < SHORTEST_REST:
            continue
        way = float(np.ptp(command[(time >= since) & (time <= until - LONGEST_REST)]))
        if way > FAR:
            yield (
                f"the position of {name} does not change from {since:.1f} to {until:.1f} s while its target "
                f"moves by {way:.2g}: its encoder, a stop, or a drive that is off or at its limit"
            )


def _ends(name: str, time: FloatArray, position: FloatArray, command: FloatArray) -> Iterator[str]:
    """Ends of the positions (N,) at which a joint waits for a command that is far beyond."""
    step = resolution(position)
    for sign, side in ((1.0, "above"), (-1.0, "below")):
        end = float((sign * position).max())
        near = sign * position >= end - (AT_END * step if np.isfinite(step) else 0.0)
        waiting = near & (sign * command > end + HELD)
        seconds = float(np.sum(np.diff(time)[waiting[1:] & waiting[:-1]]))
        if seconds > LONGEST_REST and np.ptp(position) > FAR:
            beyond, first = float((sign * command - end).max()), float(time[int(np.argmax(waiting))])
            yield (
                f"{name} stays at {sign * end:.3g} for {seconds:.1f} s, first at {first:.1f} s, while its target is up "
                f"to {beyond:.2g} {side}: a limit of the joint, or commands that the follower clips"
            )


def _drift(motion: CommandedMotion) -> Iterator[str]:
    """A drift of the commands' clock against the positions', where it explains most of what else is left."""
    whole = float(motion.time[-1] - motion.time[0])
    count = int(whole / WINDOW)
    if count < 4:
        return
    most = int(MOST_DRIFT * whole / SHIFT)
    shifts = SHIFT * np.arange(-most // 2, most // 2 + int(MOST_LAG / SHIFT) + 1)
    left = np.zeros((count, len(shifts)))  # of the windows' positions, by the shift of their commands
    for window in range(count):
        inside = (motion.time >= motion.time[0] + window * WINDOW) & (
            motion.time < motion.time[0] + (window + 1) * WINDOW
        )
        if np.count_nonzero(inside) < 10:
            continue
        position = motion.position[inside] - motion.position[inside].mean(axis=0)
        asked = motion.held((motion.time[inside] - shifts[:, None]).ravel()).reshape(len(shifts), *position.shape)
        asked -= asked.mean(axis=1, keepdims=True)
        power = np.maximum(np.einsum("sij,sij->sj", asked, asked), 1e-12)
        slope = np.clip(np.einsum("sij,ij->sj", asked, position) / power, 0.0, None)
        left[window] = np.sum((position - slope[:, None] * asked) ** 2, axis=(1, 2))
    middles = (np.arange(count) + 0.5) / count - 0.5
    steps = np.arange(-most, most + 1)
    places = np.arange(len(shifts))
    costs = np.full((len(steps), len(shifts)), np.inf)
    for row, step in enumerate(steps):
        at = np.rint(places[:, None] + step * middles).astype(np.intp)
        able = np.all((at >= 0) & (at < len(shifts)), axis=1)
        costs[row, able] = left[np.arange(count), at[able]].sum(axis=1)
    least = costs.min(axis=1)
    best = int(np.argmin(least))
    drift = float(SHIFT * steps[best])
    if abs(drift) > LEAST_DRIFT and least[best] < LEFT * least[most]:
        yield (
            f"positions fall {drift:.2f} s behind their commands over {whole:.0f} s ({100 * drift / whole:.2g} %): the "
            "clocks of both drift apart"
        )


def _holds(motion: CommandedMotion) -> Iterator[str]:
    """Commands of all joints that stand still amid motion, and jump on: some were not recorded, or not sent."""
    time, target = motion.command_time, motion.commands[TARGET]
    still = np.all(np.diff(target, axis=0) == 0.0, axis=1)
    spans = []
    for begin, end in true_runs(still):
        before, after = slice(max(0, begin - USUAL), begin), slice(end + 1, end + 1 + USUAL)
        around = np.concatenate([still[before], still[after]])
        if time[end] - time[begin] < SHORTEST_HOLD or len(around) < 2 * USUAL or around.any():
            continue
        changes = np.abs(np.diff(target, axis=0))
        usual = np.median(np.concatenate([changes[before], changes[after]]), axis=0)
        if np.any((changes[end] > HOLD_JUMP * usual) & (usual > 0.0)):
            spans.append((float(time[begin]), float(time[end])))
    if spans:
        first, last = max(spans, key=lambda span: span[1] - span[0])
        others = f" and {len(spans) - 1} more times" if len(spans) > 1 else ""
        yield (
            f"the commands of all joints stand still from {first:.2f} to {last:.2f} s{others}, and jump on: they were "
            "lost on their way to the recording, or to the servos"
        )
