"""The rows that a page shows: a ring that drops the oldest and never a torn row, and their envelope."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from daq.live.page import PageView, page_view, skeleton
from daq.live.page_server import KEPT, Envelope
from daq.live.shared_rows import SharedRows
from daq.robot.loader import load_robot
from drivers.streams import Batch, ChannelLayout, StreamLayout
from ident.excite.constraints.placements import place_arm
from ident.model.dynamic_model import build_model


@given(blocks=st.lists(st.integers(0, 30), max_size=8), capacity=st.integers(2, 12))
def test_a_reader_gets_the_newest_rows_in_order_and_each_once(blocks, capacity):
    rows = SharedRows.create(("a", "b"), capacity)
    reader = SharedRows.attach(rows.handle)
    try:
        written, read = 0, 0
        for block in blocks:
            added = np.arange(written, written + block, dtype=np.float64)
            rows.append(added, np.column_stack([added, -added]))
            written += block
            new, read = reader.read(read)
            expected = np.arange(written - min(block, capacity), written)
            np.testing.assert_array_equal(new, np.column_stack([expected, expected, -expected]))
            assert read == written
    finally:
        reader.close()
        rows.close()


def test_rows_that_are_overwritten_while_they_are_read_are_dropped():
    rows = SharedRows.create(("a",), 8)
    try:
        rows.append(np.arange(8.0), np.zeros((8, 1)))

        class Overtaken(SharedRows):
            """Four more rows are being written when the counts are looked at again."""

            looks = 0

            @property
            def _counts(self):
                self.looks += 1
                return np.array([8, 8 if self.looks == 1 else 12])

            @_counts.setter
            def _counts(self, _):
                """The array of the memory is not needed."""

        new, count = Overtaken(rows._memory, rows.handle, owner=False).read(0)
        np.testing.assert_array_equal(new[:, 0], [4, 5, 6, 7])
        assert count == 8
    finally:
        rows.close()


def decoded(message: bytes) -> tuple[np.ndarray, np.ndarray]:
    groups, channels = np.frombuffer(message, "<u4", 2)
    times = np.frombuffer(message, "<f8", 2 * groups, 8).reshape(groups, 2)
    return times, np.frombuffer(message, "<f4", offset=8 + 16 * groups).reshape(groups, 2, channels)


@given(count=st.integers(1, 40), seed=st.integers(0, 99))
def test_no_peak_is_lost_in_an_envelope(count, seed):
    rows = np.random.default_rng(seed).normal(size=(count, 3))
    rows[:, 0] = np.arange(count)
    rows[0, 1] = np.nan
    times, values = decoded(Envelope().add(rows, 5))
    assert len(times) == min(count, 5)
    assert (times[0, 0], times[-1, 1]) == (0, count - 1)
    np.testing.assert_array_equal(np.fmin.reduce(values[:, 0]), np.fmin.reduce(rows[:, 1:]).astype(np.float32))
    np.testing.assert_array_equal(np.fmax.reduce(values[:, 1]), np.fmax.reduce(rows[:, 1:]).astype(np.float32))


def test_a_page_that_is_opened_later_gets_the_last_minute():
    envelope = Envelope()
    assert envelope.history is None
    for second in range(70):
        envelope.add(np.column_stack([second + np.arange(100) / 100, np.full(100, 1e300)]), 100)
    times, values = decoded(envelope.history)
    assert len(times) == KEPT
    assert times[-1, 1] == 69.99
    assert np.isfinite(values).all()


def test_a_session_shows_the_stream_of_its_joints_beside_its_terminal():
    class Beside:
        """Keeps what it was given."""

        def __init__(self) -> None:
            self.seen: list[object] = []

        def add(self, batch: Batch) -> None:
            self.seen.append(batch)

        def show(self, state: str, elapsed: float, total: float) -> None:
            self.seen.append(state)

        def append(self, time: np.ndarray, rows: np.ndarray) -> None:
            self.seen += zip(time.tolist(), rows.tolist(), strict=True)

    page, terminal = Beside(), Beside()
    layout = StreamLayout("joints", (ChannelLayout("position", ("a", "b")), ChannelLayout("current", ("a", "b"))))
    view = PageView(page, layout, terminal)
    batch = Batch("joints", np.array([1.0, 2.0]), np.zeros(2), {"current": np.array([[1.0, 2.0], [3.0, 4.0]])})
    for one in (batch, Batch("joints", np.empty(0), np.empty(0)), Batch("other", np.zeros(1), np.zeros(1))):
        view.add(one)
    view.add(broken := Batch("joints", np.zeros(1), np.zeros(1), {"current": np.zeros((7, 9))}))
    view.show("motion", 0.0, 1.0)
    assert [time for time, _ in page.seen] == [1.0, 2.0]
    assert [row[2:] for _, row in page.seen] == [[1.0, 2.0], [3.0, 4.0]]
    assert np.isnan([row[:2] for _, row in page.seen]).all()
    assert terminal.seen[0] is batch
    assert terminal.seen[3:] == [broken, "motion"]
    with page_view(load_robot("ur5e"), [], shown=False, beside=terminal) as shown:
        assert shown is terminal


def test_the_drawn_arm_is_that_of_the_model():
    for name in ("ur5e", "so101", "sr400"):
        robot_file = load_robot(name)
        arm = skeleton(robot_file)
        if robot_file.robot.model.loops:
            assert arm is None
            continue
        model = build_model(robot_file)
        zero = place_arm(model, np.zeros((len(arm), 1)))
        origins = {joint.name: zero.origin[k, :, 0] for k, joint in enumerate(model.joints)}
        for joint, drawn in zip(robot_file.robot.joints, arm, strict=True):
            np.testing.assert_allclose(drawn["point"], origins[joint.name], atol=1e-5)  # models round what URDFs state
            assert drawn["parent"] < robot_file.robot.joint_names.index(joint.name)
