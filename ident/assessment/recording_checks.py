"""Checks of a recording without identification: its end, import, time stamps, clipped signals, outliers.

Stamps that are off by a constant factor make velocities wrong by it and accelerations by its square, and the model
still fits its own data: the parameters absorb the factor.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from daq.recording.quality.clocks import ClockEstimate, ClockFit
from daq.recording.quality.signal_quality import ColumnQuality, channel_quality, unsigned_joints
from daq.recording.quality.stale_samples import fresh_recording, stale_rows
from daq.recording.quality.stream_quality import StreamQuality, stream_quality
from daq.recording.recording import COMMANDS_STREAM, HAND_GUIDED, JOINTS_STREAM, MOTOR_SIGNALS, Channel, Recording
from daq.recording.repairs import DROP_REPEATS
from daq.recording.unit_plausibility import SPEED_QUANTILE, displacement_ratios, other_unit
from drivers.core.text import counted, first_few, percent_text, percentage_text
from ident.assessment.column_checks import MOST_SHOWN, column_checks, jump_checks
from ident.ranges import RECORDED_POSITION, RECORDED_TORQUE
from ident.verdict.catalogue import raised
from ident.verdict.check import Check

JITTER_SHARE = 0.2
"""Jitter beyond this share of the period makes the velocity of a steadily moving joint wrong by as much."""

CLIPPED_PERCENT = 0.1
"""Share of clipped samples [%] beyond which clipping is reported."""

FILLED_PERCENT = 0.1
"""Share of filled samples [%] beyond which they are reported."""


MOVING = {"velocity": "velocity goes on", "target": "target goes on", "jump": "joint moves on (it jumps at the end)"}
"""What shows that a joint moves whose encoder stands still."""

IMPORT = "import"
"""Source of the events that importers write."""
SAME_FACTOR = 0.02
"""Ratios of position change to ∫velocity dt within this share of each other are one factor; within it of 1, right."""
VELOCITY_UNITS = {"rpm": np.pi / 30.0, "deg/s": np.pi / 180.0, "rev/s": 2.0 * np.pi}
"""Other units of velocity [rad/s]: factors that no unit of time stamps makes."""
SAME_UNIT = 0.01
"""A factor within this share of a unit's is that unit's."""
BEYOND_LIMITS = 3.0
"""Speed over its limit, median of the joints, that no wrong stamps explain: velocities have another unit."""
CLOCK_DRIFT = 1e-3
"""Drift [s/s] from which on a clock is wrong; quartz clocks drift by 1e-4 at most."""
DRIFT_INTERVALS = 3.0
"""A drift is reported where it is beyond so many times its interval, which a computer that is busy makes too small."""
CLOCK_SPAN = 5.0
"""Shorter streams [s] do not determine their clock."""


def stream_qualities(recording: Recording) -> dict[str, StreamQuality]:
    """Evenness of each stream's clock, by its name."""
    return {name: stream_quality(stream.time) for name, stream in recording.streams.items()}


def column_qualities(
    recording: Recording, quantities: tuple[str, ...] | None = None
) -> dict[tuple[str, str], tuple[ColumnQuality, ...]]:
    """Figures of all columns without stale rows, by stream and quantity; of some quantities where they are named."""
    recording, _ = fresh_recording(recording)
    unsigned = unsigned_signals(recording)
    return {
        (name, quantity): channel_quality(
            replace(channel, magnitude=channel.magnitude or quantity in unsigned), stream.time
        )
        for name, stream in recording.streams.items()
        for quantity, channel in stream.channels.items()
        if quantities is None or quantity in quantities
    }


def unsigned_signals(recording: Recording) -> dict[str, tuple[str, ...]]:
    """Motor signals of the joint stream that have lost their sign, though nothing says so; by which joints it shows."""
    stream = recording.streams.get(JOINTS_STREAM)
    position = None if stream is None else stream.channels.get("position")
    if stream is None or position is None:
        return {}
    found: dict[str, tuple[str, ...]] = {}
    for quantity in MOTOR_SIGNALS:
        channel = stream.channels.get(quantity)
        if channel is not None and not channel.magnitude and channel.columns == position.columns:
            joints = tuple(channel.columns[joint] for joint in unsigned_joints(channel.values, position.values))
            found |= {quantity: joints} if joints else {}
    return found


def closing_checks(recording: Recording) -> list[Check]:
    """Check whether the recording's writer closed it."""
    if recording.complete:
        return []
    stop = recording.stopped_by
    ended = f"was stopped: {stop}" if stop else "was not closed properly: its end may be missing"
    return [raised("recording-not-closed", f"{recording.label} {ended}")]


def recording_checks(
    recording: Recording,
    streams: Mapping[str, StreamQuality] | None = None,
    columns: Mapping[tuple[str, str], tuple[ColumnQuality, ...]] | None = None,
    label: str = "",
) -> list[Check]:
    """Properties of a recording.

    Args:
        recording: as read.
        streams: its `stream_qualities`, where they are known already.
        columns: its `column_qualities`, where they are known already.
        label: names the recording among several.
    """
    streams = stream_qualities(recording) if streams is None else streams
    columns = column_qualities(recording, ("position", *MOTOR_SIGNALS)) if columns is None else columns
    of = f"{label}: " if label else ""
    checks = closing_checks(recording)
    for event in recording.events:
        if event.source == IMPORT and event.level == "warning":
            checks.append(raised("import-warning", f"{of}import: {event.message}"))
        if event.message.startswith(HAND_GUIDED):
            checks.append(raised("hand-guided", f"{of}the arm was led by hand ({event.message})"))
    for name, quality in streams.items():
        if quality.lost and name != COMMANDS_STREAM:  # a command holds until the next one
            share = quality.lost / (quality.samples + quality.lost)
            gaps = counted(len(quality.gaps), "gap")
            text = f"{of}{name}: {counted(quality.lost, 'sample')} lost ({percent_text(share, 2)}) in {gaps}"
            checks.append(raised("samples-lost", text))
        if quality.duplicates:
            checks.append(raised("repeated-stamps", f"{of}{name}: {quality.duplicates} stamps do not increase"))
        if quality.jitter_ms * quality.rate_hz > JITTER_SHARE * 1e3 and name != COMMANDS_STREAM:
            period = 1e3 / quality.rate_hz
            text = f"{of}{name}: stamps jitter by {quality.jitter_ms:.2g} ms at a period of {period:.2g} ms"
            checks.append(raised("jittering-stamps", text))
    stale = stale_checks(recording, of)
    stuck = {joint for check in stale if check.name == "encoder-stuck" for joint in check.joints}
    checks += time_axis_checks(recording, of, stuck)
    checks += stale + unit_checks(recording, of) + column_checks(recording, of)
    frozen = {joint for check in checks if check.name == "torque-frozen" for joint in check.joints}
    for quantity, joints in unsigned_signals(recording).items():
        text = (
            f"{of}{quantity} never changes sign although it returns to 0 and the joints reverse ({', '.join(joints)}): "
            "it is a magnitude; state it in the robot file (drives: signal: magnitude) and identify a servo model "
            "from commands and encoder (--method servo), or record it with its sign"
        )
        checks.append(raised("unsigned-signal", text, joints))
    for (stream, quantity), qualities in columns.items():
        clipped = [
            column
            for column in qualities
            if column.clipped_percent > CLIPPED_PERCENT
            and not column.filled_percent > FILLED_PERCENT
            and column.name not in frozen
        ]
        if quantity in MOTOR_SIGNALS and clipped:
            figures = ", ".join(f"{column.name} {percentage_text(column.clipped_percent, 2)} %" for column in clipped)
            text = f"{of}{stream}/{quantity} is clipped: {figures} of the samples; use a slower motion or a wider range"
            checks.append(raised("signal-clipped", text, [column.name for column in clipped]))
        if quantity in ("position", *MOTOR_SIGNALS):
            checks += _unusable_checks(f"{of}{stream}/{quantity}", recording.streams[stream].channels[quantity])
            checks += _filled_checks(f"{of}{stream}/{quantity}", qualities)
            checks += _outlier_checks(f"{of}{stream}/{quantity}", qualities)
    return checks


def stale_checks(recording: Recording, of: str = "") -> list[Check]:
    """Rows of the joint stream that were not measured anew; `of` begins their sentences."""
    stale, checks = stale_rows(recording), []
    if stale is None:
        return []
    first = float(recording.streams[JOINTS_STREAM].time[0])
    repeats = stale.repeated | stale.held
    if repeats.any():
        counts = ((stale.repeated, "rows repeat the one before"), (stale.held, "repeat only its positions"))
        what = ", ".join(f"{np.count_nonzero(rows)} {text}" for rows, text in counts if rows.any())
        text = (
            f"{of}{what} while the arm moves ({percent_text(float(np.mean(repeats)), 2)} of all rows): they are "
            f"dropped; read the controller no faster than it measures, or import with --repair {DROP_REPEATS}"
        )
        checks.append(raised("rows-repeated", text))
    if stale.encoders:
        shown = [
            f"{encoder.joint} from {encoder.start - first:.2f} to {encoder.stop - first:.2f} s while its "
            f"{MOVING[encoder.evidence]}"
            for encoder in stale.encoders
        ]
        left = "these samples are left out" if stale.stuck[stale.left_out].any() else "too long to be left out"
        text = f"{of}the position is stuck: {first_few(shown, MOST_SHOWN, '; ')}: {left}; check the encoder"
        checks.append(raised("encoder-stuck", text, sorted({encoder.joint for encoder in stale.encoders})))
    if stale.off is not None and stale.off.any():
        share = percent_text(float(np.mean(stale.off)), 2)
        checks.append(raised("motors-off", f"{of}a motor is off in {share} of the rows: they are left out"))
    return checks + jump_checks(stale.jumps, first, of)


def unit_checks(recording: Recording, of: str = "") -> list[Check]:
    """Positions that are in degrees, millimetres or encoder counts by the joints' limits; `of` begins the sentence."""
    stream = recording.streams.get(JOINTS_STREAM)
    if not recording.robot_text or stream is None or "position" not in stream.channels:
        return []
    position = stream.channels["position"]
    found: dict[str, list[str]] = {}
    for limits in recording.robot().robot.joints:
        if limits.name in position.columns:
            column = position.values[:, position.columns.index(limits.name)]
            known = np.isfinite(column)
            unit = other_unit(stream.time[known], column[known], limits)
            if unit is not None:
                found.setdefault(unit, []).append(limits.name)
    return [
        raised("position-unit", f"{of}by range and speed the positions of {', '.join(names)} are in {unit}", names)
        for unit, names in found.items()
    ]


def _unusable_checks(signal: str, channel: Channel) -> list[Check]:
    """Values of a signal with which nothing can be identified."""
    allowed = RECORDED_POSITION if channel.quantity == "position" else RECORDED_TORQUE
    bad = ~(np.abs(channel.values) <= allowed.most)
    if not np.any(bad):
        return []
    joints = [channel.columns[joint] for joint in np.flatnonzero(np.any(bad, axis=0))]
    first, count = int(np.argmax(np.any(bad, axis=1))), int(np.count_nonzero(bad))
    text = f"{signal}: {count} values of {', '.join(joints)} are not numbers within {allowed}, first at sample {first}"
    return [raised("values-unusable", f"{text}; leave them out (import with --repair drop-nan)", joints)]


def _filled_checks(signal: str, columns: Sequence[ColumnQuality]) -> list[Check]:
    """Drop-outs of a signal that were filled with zeros."""
    filled = [column for column in columns if column.filled_percent > FILLED_PERCENT]
    if not filled:
        return []
    figures = ", ".join(f"{column.name} {percentage_text(column.filled_percent, 2)} %" for column in filled)
    text = (
        f"{signal} is 0 between values far from 0 ({figures} of the samples): drop-outs were filled with zeros; leave "
        "these samples out, or write NaN and import with --repair drop-nan"
    )
    return [raised("filled-with-zeros", text, [column.name for column in filled])]


def _outlier_checks(signal: str, columns: Sequence[ColumnQuality]) -> list[Check]:
    """Single wrong samples of a signal: those that are replaced, and columns with too many of them."""
    few = [column for column in columns if column.outliers and not column.outliers_stay]
    many = [column for column in columns if column.outliers_stay]
    checks = []
    if few:
        counts = ", ".join(f"{column.name} {column.outliers}" for column in few)
        text = (
            f"{signal}: single outliers ({counts}) are replaced by interpolation: check the encoder, its cable and the "
            "bus"
        )
        checks.append(raised("outliers-replaced", text, [column.name for column in few]))
    if many:
        counts = ", ".join(f"{column.name} {column.outliers}" for column in many)
        text = (
            f"{signal}: there are too many outliers ({counts}) to replace: the fit uses them as they are; find the "
            "disturbance and record again"
        )
        checks.append(raised("many-outliers", text, [column.name for column in many]))
    return checks


@dataclass(frozen=True)
class TimeAxis:
    """Consistency of a recording's time stamps."""

    # joint → change of position over ∫velocity dt; joints without a clear relation are left out
    velocity_ratios: Mapping[str, float]
    # stream → its clock against the host's; streams without their own clock are left out
    clocks: Mapping[str, ClockEstimate]

    @property
    def factor(self) -> float | None:
        """Factor for all stamps by the recorded velocities; None where they agree or are inconclusive."""
        ratios = np.array(list(self.velocity_ratios.values()))
        if len(ratios) < 2 or np.min(ratios) <= 0.0:
            return None
        typical = float(np.median(ratios))
        same = bool(np.all(np.abs(ratios / typical - 1.0) < SAME_FACTOR))
        return typical if same and abs(typical - 1.0) > SAME_FACTOR else None

    @property
    def velocity_unit(self) -> str | None:
        """The unit that the velocities of all joints are in instead of rad/s; None where `factor` is none of these."""
        factor = self.factor
        for unit, value in VELOCITY_UNITS.items():
            if factor is not None and abs(factor / value - 1.0) < SAME_UNIT:
                return unit
        return None


def time_axis(recording: Recording) -> TimeAxis:
    """Compare recorded velocities with positions, and the streams' clocks with the host's."""
    ratios: dict[str, float] = {}
    stream = recording.streams.get(JOINTS_STREAM)
    position, velocity = (None if stream is None else stream.channels.get(name) for name in ("position", "velocity"))
    if stream is not None and position is not None and velocity is not None:
        names = [name for name in position.columns if name in velocity.columns]
        moved = position.values[:, [position.columns.index(name) for name in names]]
        speed = velocity.values[:, [velocity.columns.index(name) for name in names]]
        finite = np.isfinite(stream.time) & np.isfinite(moved).all(axis=1) & np.isfinite(speed).all(axis=1)
        if np.count_nonzero(finite) > 1:
            values = displacement_ratios(stream.time[finite], moved[finite], speed[finite])
            ratios = {name: ratio for name, ratio in zip(names, values, strict=True) if ratio is not None}
    clocks = {}
    for name, recorded in recording.streams.items():
        fit = ClockFit()
        fit.add(recorded.time, recorded.host_time)
        estimate = fit.estimate()
        if estimate is not None and estimate.span >= CLOCK_SPAN:
            clocks[name] = estimate
    return TimeAxis(ratios, clocks)


def time_axis_checks(recording: Recording, of: str = "", stuck: Collection[str] = ()) -> list[Check]:
    """The checks that the time stamps raise; `of` begins their sentences, of joints whose encoder was not `stuck`."""
    axis = time_axis(recording)
    axis = replace(
        axis, velocity_ratios={joint: ratio for joint, ratio in axis.velocity_ratios.items() if joint not in stuck}
    )
    checks = []
    unit = axis.velocity_unit
    if unit is not None:
        text = (
            f"{of}judging by the positions, the recorded velocities of all joints are in {unit}, not in rad/s: "
            "convert them"
        )
        checks.append(raised("velocity-scale", text, axis.velocity_ratios))
    elif axis.factor is not None and _faster_than_limits(recording, 1.0 / axis.factor):
        text = (
            f"{of}the recorded velocities of all joints are {1.0 / axis.factor:.4g} times the change of position per "
            "time: they are the motors' (gear ratio), or have another unit than rad/s"
        )
        checks.append(raised("velocity-scale", text, axis.velocity_ratios))
    elif axis.factor is not None:
        text = (
            f"{of}in all joints, positions change {axis.factor:.4g} times as fast as recorded: unless the velocities "
            f"have another unit, the stamps should be multiplied by {axis.factor:.4g}; check their unit and rate"
        )
        checks.append(raised("wrong-time-axis", text))
    else:
        off = {name: ratio for name, ratio in axis.velocity_ratios.items() if abs(ratio - 1.0) > SAME_FACTOR}
        if off:
            ratios = ", ".join(f"{name} {ratio:.4g}" for name, ratio in off.items())
            text = (
                f"{of}the recorded velocity differs from the change of position by a factor: {ratios}; check its unit"
            )
            checks.append(raised("velocity-scale", text, off))
    for name, clock in axis.clocks.items():
        if abs(clock.drift) > max(CLOCK_DRIFT, DRIFT_INTERVALS * clock.drift_error):
            text = (
                f"{of}the clock of '{name}' drifts by {clock.drift:.3g} ± {clock.drift_error:.1g} s per second against "
                f"this computer's: its stamps should be multiplied by {1.0 + clock.drift:.6g}; check its unit and rate"
            )
            checks.append(raised("clocks-drift", text))
    return checks


def _faster_than_limits(recording: Recording, factor: float) -> bool:
    """Return whether the joints would be far faster than they can be if they moved so many times as fast."""
    if not recording.robot_text:
        return False
    stream = recording.streams[JOINTS_STREAM]
    position, limits = stream.channels["position"], {one.name: one.velocity for one in recording.robot().robot.joints}
    passed = np.diff(stream.time)
    speeds = np.abs(np.diff(position.values, axis=0))[passed > 0] / passed[passed > 0, None]
    most = np.array([limits.get(name, np.inf) for name in position.columns])
    return bool(np.median(factor * np.quantile(speeds, SPEED_QUANTILE, axis=0) / most) > BEYOND_LIMITS)
