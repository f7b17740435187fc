"""TPDO frames into rows: each drive answers each SYNC once with each TPDO; frames are decoded in batches with NumPy."""

from __future__ import annotations

import bisect
import itertools
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from drivers.can.bus import Frame
from drivers.canopen402.protocol.objects import TPDO_BASES
from drivers.canopen402.samples.temperature import RATE as THERMAL_RATE
from drivers.core.arrays import FloatArray, IntArray
from drivers.gains import torque_at_joints
from drivers.streams import ChannelLayout, StreamLayout

_STATE = np.dtype([("statusword", "<u2"), ("mode", "i1"), ("position", "<i4")])
_EFFORT = np.dtype([("velocity", "<i4"), ("torque", "<i2"), ("current", "<i2")])
TPDO_SIZES = (_STATE.itemsize, _EFFORT.itemsize)
"""Bytes of each TPDO."""
_FRAME_BYTES = 8
LATENESS = 0.02
"""How long [s] answers may stay behind before one of them counts as missing: ordinary computers stall for as long."""
REST_LATENESS = 0.2
"""The same while the arm is at rest, where rows may be handed out late."""
_SMOOTHING = 0.05
PER_MILLE = 1e-3

_DESCRIPTIONS = {
    "position": "actual position (object 0x6064)",
    "velocity": "actual velocity, as the drive derives it (object 0x606C)",
    "current": "actual current, raw, in the joint's direction (object 0x6078 times the rated current)",
    "torque": "actual torque, as the drive derives it (object 0x6077 times the rated torque)",
}
_LATENESS_DESCRIPTION = "how much later than its schedule SYNC was sent; part of 'time', as drives measure then"
_STATUS_DESCRIPTION = "statusword of the drive (object 0x6041, CiA 402)"


@dataclass(frozen=True)
class Scaling:
    """Factors between a drive's numbers and a joint's; arrays (n,)."""

    counts_per_turn: FloatArray  # position counts a joint revolution
    direction: FloatArray  # 1 or -1, of all that the drive says
    zero: FloatArray  # joint position at count 0 [rad]
    rated_current: FloatArray  # [A]
    rated_torque: FloatArray  # [N·m]
    # R (n, n) of q_motor = R·q_joint; None where each drive moves its own joint alone
    coupling: FloatArray | None = None

    @property
    def radians_per_count(self) -> FloatArray:
        """(n,) with the direction's sign [rad]."""
        return np.asarray(2.0 * np.pi * self.direction / self.counts_per_turn)

    def counts(self, position: FloatArray) -> IntArray:
        """The counts (n,) nearest to joint positions (n,) [rad]."""
        motors = position if self.coupling is None else self.coupling @ position
        return np.asarray(np.rint((motors - self.zero) / self.radians_per_count), dtype=np.int64)

    def per_mille(self, torque: FloatArray) -> IntArray:
        """Joint torques (n,) [N·m] as the drives count them: in thousandths of their rated ones."""
        motors = torque if self.coupling is None else np.linalg.solve(self.coupling.T, torque)
        return np.asarray(np.rint(motors / (PER_MILLE * self.direction * self.rated_torque)), dtype=np.int64)

    def position(self, counts: npt.ArrayLike) -> FloatArray:
        """Joint positions (…, n) [rad] of counts (…, n)."""
        return self._at_joints(np.asarray(np.asarray(counts) * self.radians_per_count + self.zero))

    def values(self, rows: AlignedRows) -> dict[str, FloatArray]:
        """Quantity → (N, n): the joints' position [rad], velocity [rad/s] and torque [N·m]; current [A], statusword."""
        torque = np.asarray(rows.torque * (PER_MILLE * self.direction * self.rated_torque))
        return {
            "position": self.position(rows.position),
            "velocity": self._at_joints(np.asarray(rows.velocity * self.radians_per_count)),
            "current": np.asarray(rows.current * (PER_MILLE * self.direction * self.rated_current)),
            "torque": torque if self.coupling is None else torque_at_joints(torque, self.coupling),
            "statusword": rows.statusword.astype(np.float64),
        }

    def _at_joints(self, motion: FloatArray) -> FloatArray:
        """Motion (…, n) of the joints, from that of the motors."""
        return (
            motion
            if self.coupling is None
            else np.asarray(np.linalg.solve(self.coupling, motion[..., np.newaxis])[..., 0])
        )


@dataclass(frozen=True)
class AlignedRows:
    """What the drives said, a row a SYNC; (N, n) in the drives' own numbers."""

    slot: IntArray  # (N,) number of the SYNC in its producer's schedule
    sent: FloatArray  # (N,) when it was sent [s, host's monotonic clock]
    host_time: FloatArray  # (N,) arrival of the last frame of the row [s, host's monotonic clock]
    statusword: IntArray
    mode: IntArray
    position: IntArray
    velocity: IntArray
    torque: IntArray
    current: IntArray


@dataclass(frozen=True)
class Aligned:
    """Rows, and what was wrong with the frames; counts are (2, n): TPDO, drive."""

    rows: AlignedRows  # complete ones
    missing: IntArray  # SYNCs without an answer
    extra: IntArray  # answers beyond one a SYNC; the last one counts
    misfit: IntArray  # frames of another length than the mapping's, left out


class _Answers:
    """The answers of one drive with one TPDO, SYNC after SYNC.

    They come in the order of the SYNCs, so that the oldest SYNC without an answer gets the next one, even where that
    comes after the following SYNC. Where answers stay behind for longer than they may, either one is missing, that of
    the first SYNC after which nothing came, or all have become late; how long after a SYNC this drive usually answers
    tells which.
    """

    def __init__(self, period: float) -> None:
        self.of: dict[int, Frame] = {}
        """Number of the SYNC → its answer, as far as known."""
        self.missing = 0
        self.extra = 0
        self._period = period
        self._usual: float | None = None
        self._phases: deque[float] = deque(maxlen=max(1, round(LATENESS / period)))
        self._waiting: deque[int] = deque()
        self._empty: deque[int] = deque()

    def close_window(self, number: int, begin: float, frames: Sequence[Frame], lateness: float) -> None:
        """Assign the frames that came between SYNC `number`, sent at `begin` [s], and the next one.

        Answers may stay behind for `lateness` [s].
        """
        if not frames:
            self._empty.append(number)
        elif not self._waiting and len(frames) == 1:
            delay = frames[0][0] - begin
            self._usual = delay if self._usual is None else self._usual + _SMOOTHING * (delay - self._usual)
        self._waiting.append(number)
        for frame in frames:
            self._phases.append(frame[0] - begin)
            if self._waiting:
                self.of[self._waiting.popleft()] = frame
            else:
                self.extra += 1
                self.of[number] = frame
        if self._waiting and self._empty and number - self._empty[0] >= max(1, round(lateness / self._period)):
            first = self._empty.popleft()
            if not self._is_late():
                self._give_up(first)
        if not self._waiting:
            self._empty.clear()

    def settled(self, closed: int) -> int:
        """The first SYNC whose answer may still change or come, of those before `closed`."""
        return min([closed, *itertools.islice(self._empty, 1), *itertools.islice(self._waiting, 1)])

    def _is_late(self) -> bool:
        """Whether answers that stay behind are late, not one missing: which fits better to when they usually come."""
        if self._usual is None or not self._phases:
            return False
        behind = (len(self._waiting) - 0.5) * self._period
        return float(np.median(self._phases)) + behind < self._usual

    def _give_up(self, lost: int) -> None:
        """One SYNC has no answer: what was taken for its answer and for later ones belongs one SYNC later."""
        self.missing += 1
        behind = self._waiting.popleft()
        for number in range(behind, lost, -1):
            self.of[number] = self.of[number - 1]
        self.of.pop(lost, None)


class Aligner:
    """Assigns frames to SYNCs: each drive answers each SYNC once with each TPDO.

    A row is handed out when everything that arrived before the next SYNC is known, since only then nothing more can
    belong to it, and every drive has answered or is known not to.

    A drive that leaves one answer out and sends one of the next few twice is indistinguishable from one that was late.

    Args:
        ids: node ids of the n drives.
        rate: of SYNC [Hz].
    """

    def __init__(self, ids: Sequence[int], rate: float) -> None:
        keys = [base + node for base in TPDO_BASES for node in ids]
        sizes = [size for size in TPDO_SIZES for _ in ids]
        self._count = len(ids)
        self._answers = {key: _Answers(1.0 / rate) for key in keys}
        self._sizes = dict(zip(keys, sizes, strict=True))
        self._misfit = dict.fromkeys(keys, 0)
        self._strays = dict.fromkeys(keys, 0)
        self._frames: list[Frame] = []
        self._syncs: deque[tuple[int, float]] = deque()
        self._closed = 0
        self._handed_out = 0
        self._totals = np.zeros((3, 2, self._count), dtype=np.int64)

    @property
    def wanted(self) -> int:
        """Frames to come until the next SYNC has its first answer, where none is lost."""
        return max(1, 2 * self._count + 1 - len(self._frames))

    def feed(
        self, frames: Sequence[Frame], syncs: Sequence[tuple[int, float]], drained: float, *, at_rest: bool = False
    ) -> Aligned:
        """Hand out as many rows as can be, given new frames, and slots and times [s] of new SYNCs.

        All that arrived before `drained` [s] has been fed. At rest answers may stay behind for `REST_LATENESS`, in
        place of `LATENESS`.
        """
        self._frames.extend(frames)
        self._syncs.extend(syncs)
        waiting = self._closed - self._handed_out
        times = [time for _, time in itertools.islice(self._syncs, waiting, None)]
        ready = max(0, bisect.bisect_right(times, drained) - 1)
        if ready:
            self._close(times[: ready + 1], REST_LATENESS if at_rest else LATENESS)
        settled = min(answers.settled(self._closed) for answers in self._answers.values())
        rows = self._rows(settled)
        totals = np.array(
            [
                [answers.missing for answers in self._answers.values()],
                [answers.extra + self._strays[key] for key, answers in self._answers.items()],
                list(self._misfit.values()),
            ]
        ).reshape(3, 2, self._count)
        new, self._totals = totals - self._totals, totals
        return Aligned(rows, new[0], new[1], new[2])

    def _close(self, times: Sequence[float], lateness: float) -> None:
        """Close the windows between consecutive times [s]."""
        windows: list[dict[int, list[Frame]]] = [{} for _ in times[1:]]
        kept = []
        for frame in self._frames:
            arrived, key, data = frame
            if arrived >= times[-1]:
                kept.append(frame)
            elif len(data) != self._sizes[key]:
                self._misfit[key] += 1
            elif arrived < times[0]:
                self._strays[key] += 1
            else:
                windows[bisect.bisect_right(times, arrived) - 1].setdefault(key, []).append(frame)
        self._frames = kept
        for begin, window in zip(times, windows, strict=False):
            for key, answers in self._answers.items():
                answers.close_window(self._closed, begin, window.get(key, ()), lateness)
            self._closed += 1

    def _rows(self, end: int) -> AlignedRows:
        """The complete rows from the last one handed out to before SYNC number `end`."""
        slots, sent, chosen = [], [], []
        for number in range(self._handed_out, end):
            slot, time = self._syncs.popleft()
            answered = [answers.of.pop(number, None) for answers in self._answers.values()]
            row = [frame for frame in answered if frame is not None]
            if len(row) == len(answered):
                slots.append(slot)
                sent.append(time)
                chosen += row
        self._handed_out = max(end, self._handed_out)
        arrival = np.array([frame[0] for frame in chosen], dtype=np.float64).reshape(len(slots), 2 * self._count)
        data = b"".join([frame[2].ljust(_FRAME_BYTES, b"\0") for frame in chosen])
        frames = np.frombuffer(data, dtype=np.uint8).reshape(len(slots), 2 * self._count, _FRAME_BYTES)
        return _decode(np.array(slots, dtype=np.int64), np.array(sent, dtype=np.float64), arrival, frames, self._count)


def _decode(
    slots: IntArray, sent: FloatArray, arrival: FloatArray, frames: npt.NDArray[np.uint8], count: int
) -> AlignedRows:
    """Rows of frames (N, 2n, 8) that arrived at (N, 2n) [s]."""
    state = _records(frames[:, :count], _STATE)
    effort = _records(frames[:, count:], _EFFORT)
    return AlignedRows(
        slot=slots,
        sent=sent,
        host_time=arrival.max(axis=1) if len(slots) else np.zeros(0),
        statusword=state["statusword"].astype(np.int64),
        mode=state["mode"].astype(np.int64),
        position=state["position"].astype(np.int64),
        velocity=effort["velocity"].astype(np.int64),
        torque=effort["torque"].astype(np.int64),
        current=effort["current"].astype(np.int64),
    )


def _records(frames: npt.NDArray[np.uint8], layout: np.dtype[np.void]) -> npt.NDArray[np.void]:
    return np.ascontiguousarray(frames[..., : layout.itemsize]).view(layout)[..., 0]


def stream_layouts(joints: Sequence[str], warm: Sequence[str], rate: float) -> tuple[StreamLayout, ...]:
    """`joints` at the rate of SYNC [Hz]; `thermal` with a column for every joint whose drive tells a temperature."""
    channels = [ChannelLayout(name, tuple(joints), "", words) for name, words in _DESCRIPTIONS.items()]
    channels.append(ChannelLayout("statusword", tuple(joints), "1", _STATUS_DESCRIPTION))
    channels.append(ChannelLayout("sync_lateness", ("sync",), "s", _LATENESS_DESCRIPTION))
    layouts = [StreamLayout("joints", tuple(channels), rate)]
    if warm:
        channel = ChannelLayout("temperature", tuple(warm), "", "temperature object of the drive, read by SDO")
        # A drive that answers no SDO for a second is reported by the poll; it is no reason to stop a motion.
        layouts.append(StreamLayout("thermal", (channel,), THERMAL_RATE, essential=False))
    return tuple(layouts)
