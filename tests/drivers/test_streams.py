from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from each import each

from drivers.base import require_state
from drivers.core.errors import DriverStateError
from drivers.streams import UNITS, Batch, ChannelLayout, StreamLayout


@each("quantity", sorted(UNITS))
def test_known_quantities_bring_their_unit(quantity: str) -> None:
    assert ChannelLayout(quantity, ("j1",)).unit == UNITS[quantity]


def test_a_unit_that_is_given_stays() -> None:
    assert ChannelLayout("position", ("slide",), "m").unit == "m"
    assert ChannelLayout("robot_mode", ("robot_mode",), "1").unit == "1"


def test_an_unknown_quantity_needs_a_unit() -> None:
    with pytest.raises(ValueError, match="'robot_mode' needs a unit"):
        ChannelLayout("robot_mode", ("robot_mode",))


def test_every_target_has_the_unit_of_what_it_aims_at() -> None:
    targets = [quantity for quantity in UNITS if quantity.startswith("target_")]
    assert targets
    for quantity in targets:
        assert UNITS[quantity] == UNITS[quantity.removeprefix("target_")]


def test_layouts_are_values() -> None:
    one, other = (StreamLayout("joints", (ChannelLayout("position", ("a", "b")),), 500.0) for _ in range(2))
    assert one == other
    assert hash(one) == hash(other)
    with pytest.raises(dataclasses.FrozenInstanceError):
        one.rate = 1.0  # type: ignore[misc]


def test_blocks_do_not_share_their_values() -> None:
    clock = np.zeros(2)
    one, other = Batch("joints", clock, clock), Batch("joints", clock, clock)
    assert one.values is not other.values
    assert one.lost == 0


@each("allowed", ["closed", "open", "running"])
@each("actual", ["closed", "open", "running"])
def test_a_state_allows_what_is_its_own(actual: str, allowed: str) -> None:
    if actual == allowed:
        require_state(actual, allowed, "read")  # type: ignore[arg-type]
        return
    with pytest.raises(DriverStateError, match=f"cannot read while {actual}") as caught:
        require_state(actual, allowed, "read")  # type: ignore[arg-type]
    assert allowed in caught.value.hint
