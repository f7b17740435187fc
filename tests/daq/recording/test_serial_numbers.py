"""Recordings of two arms of one model are told apart by the serial numbers of their controllers."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest

from daq.recording.recording import Event, Recording
from daq.recording.serial_numbers import SERIAL_EVENT, serial_number, warn_of_other_arms
from drivers.core.errors import DynidWarning


def test_recordings_of_two_arms_are_named_and_those_of_one_or_of_unknown_ones_are_not() -> None:
    time = 0.01 * np.arange(10)
    unknown = Recording.from_arrays("up6", time=time, position=np.zeros((10, 3)), torque=np.zeros((10, 3)))
    one, two = (replace(unknown, events=(Event(0.0, "info", "driver", f"{SERIAL_EVENT}{number}"),)) for number in "12")
    assert [serial_number(run) for run in (unknown, one, two)] == ["", "1", "2"]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warn_of_other_arms([unknown, one, one])
    with pytest.warns(DynidWarning, match=r"of different arms.* of 1, .* of 2"):
        warn_of_other_arms([one, unknown, two])
