"""What CAN motors ask of their bus."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from functools import partial

from drivers.base import DriverSettings
from drivers.bus_budget import FRAME_BYTES, WORST, Budget, FrameGroup, can_frames, fd_frame_bits
from drivers.can.bus import EXTENDED, REMOTE
from drivers.can_motors.codec import CanFrame
from drivers.can_motors.settings import CODECS, parse_settings

FD_ANSWER = 32
"""Bytes of a moteus' answer to a reading, padded."""


def motor_budget(settings: DriverSettings, family: str) -> Budget:
    """The budget of a connection: a cycle with goals, or with readings alone where it only reads."""
    parsed = parse_settings(settings.connection, settings.joints, family)
    keys, codecs = parsed.keys, parsed.codecs()
    codec, speed_up = codecs[0], keys.data_bitrate / keys.bitrate

    def groups(meaning: str, frames: Sequence[CanFrame], answers: int) -> list[FrameGroup]:
        sizes = Counter((bool(identifier & REMOTE), len(data)) for identifier, data in frames)
        extended = any(identifier & EXTENDED for identifier, _ in frames)
        if codec.fd:
            sizes[False, FD_ANSWER] += answers
            return [
                FrameGroup(meaning, count, size, math.ceil(fd_frame_bits(size, speed_up)))
                for (_, size), count in sizes.items()
            ]
        sent = [
            can_frames(meaning, count, 0 if remote else size, extended=extended)
            for (remote, size), count in sizes.items()
        ]
        return [*sent, can_frames(f"answers to {meaning}", answers, FRAME_BYTES, extended=extended)]

    goals: list[FrameGroup] = []
    readings: list[FrameGroup] = []
    if not keys.read_only:
        sent = [frame for codec in codecs for frame in codec.goal(0.0)]
        goals = groups("goals", sent, len(sent) if codec.answers_goals else 0)
    if keys.read_only or not codec.answers_goals:
        polls = [frame for codec in codecs for frame in codec.poll(read_only=keys.read_only)]
        polls += codec.slow_poll()
        readings = groups("readings", polls, len(polls))
    return Budget(keys.bitrate, keys.rate, (*goals, *readings), worst=WORST)


damiao_budget, robstride_budget, cubemars_budget, moteus_budget, odrive_budget = (
    partial(motor_budget, family=family) for family in CODECS
)
