"""What CAN motors ask of their bus."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial

from drivers.base import DriverSettings
from drivers.bus_budget import Budget, FrameGroup
from drivers.can.bus import EXTENDED, REMOTE
from drivers.can.frame_length import FRAME_BYTES, WORST, can_frames, fd_frame_bits
from drivers.can_motors.codec import CanFrame
from drivers.can_motors.settings import CODECS, parse_settings

FD_ANSWER = 32
"""Bytes of a moteus' answer to a reading, padded."""


def motor_budget(settings: DriverSettings, family: str) -> Budget:
    """The budget of a connection: a cycle with goals, or with readings alone where it only reads.

    Raises:
        UsageError: the connection's keys are wrong.
    """
    parsed = parse_settings(settings.connection, settings.joints, family)
    keys, codecs = parsed.keys, parsed.codecs()
    sent = [] if keys.read_only else [frame for codec in codecs for frame in codec.goal(0.0)]
    answers = len(sent) if codecs[0].answers_goals else 0
    if keys.read_only or parsed.between or not codecs[0].answers_goals:
        polls = [frame for codec in codecs for frame in codec.poll(read_only=keys.read_only)]
        polls += codecs[0].slow_poll()
        sent, answers = sent + polls, answers + len(polls)
    extended = any(identifier & EXTENDED for identifier, _ in sent)
    if codecs[0].fd:
        speed_up = keys.data_bitrate / keys.bitrate

        def fd(meaning: str, count: int, size: int) -> FrameGroup:
            return FrameGroup(meaning, count, size, math.ceil(fd_frame_bits(size, speed_up)))

        sizes = Counter(len(data) for _, data in sent)
        cycle = [*(fd("commands", count, size) for size, count in sizes.items()), fd("answers", answers, FD_ANSWER)]
    else:
        cycle = [*_groups(sent), can_frames("answers", answers, FRAME_BYTES, extended=extended)]
    return Budget(keys.bitrate, keys.rate, tuple(cycle), worst=WORST)


def _groups(sent: Sequence[CanFrame]) -> list[FrameGroup]:
    groups = []
    for meaning, remote in (("commands", False), ("requests", True)):
        chosen = [frame for frame in sent if bool(frame[0] & REMOTE) == remote]
        if chosen:
            size = 0 if remote else len(chosen[0][1])
            groups.append(can_frames(meaning, len(chosen), size, extended=bool(chosen[0][0] & EXTENDED)))
    return groups


def _budget_of(family: str) -> Callable[[DriverSettings], Budget]:
    return partial(motor_budget, family=family)


damiao_budget, robstride_budget, cubemars_budget, moteus_budget, odrive_budget = map(_budget_of, CODECS)
