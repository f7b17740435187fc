"""Frames that no driver expects: short, long, CAN FD, remote, error frames, on identifiers that it listens to."""

from __future__ import annotations

from collections.abc import Sequence

import can
from hypothesis import strategies as st


def hostile_frames(identifiers: Sequence[int]) -> st.SearchStrategy[list[can.Message]]:
    """Some of them, any content."""
    data = st.binary(max_size=8)
    classical = st.builds(_frame, st.sampled_from(identifiers), data)
    flexible = st.builds(
        _frame, st.sampled_from(identifiers), st.sampled_from([0, 1, 8, 12, 64]).map(bytes), st.just(True)
    )
    remote = st.builds(_remote, st.sampled_from(identifiers), st.integers(0, 8))
    errors = st.builds(_error, st.integers(0, 0x1FF), data)
    truncated = st.builds(_truncated, st.sampled_from(identifiers), st.integers(1, 8))
    return st.lists(st.one_of(classical, flexible, remote, errors, truncated), min_size=1, max_size=30)


def _frame(identifier: int, data: bytes, flexible: bool = False) -> can.Message:
    return can.Message(arbitration_id=identifier, data=data, is_extended_id=False, is_fd=flexible)


def _remote(identifier: int, length: int) -> can.Message:
    return can.Message(arbitration_id=identifier, dlc=length, is_remote_frame=True, is_extended_id=False)


def _error(identifier: int, data: bytes) -> can.Message:
    return can.Message(arbitration_id=identifier, data=data, is_error_frame=True, is_extended_id=False)


def _truncated(identifier: int, length: int) -> can.Message:
    """Return a frame with a byte less than its length says."""
    data = bytes(length - 1)
    return can.Message(arbitration_id=identifier, dlc=length, data=data, is_extended_id=False, check=False)
