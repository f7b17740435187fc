"""Quality of a recording, for `dynid info`: clocks, signals, excitation, delay, expected error bars."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from daq.recording.commanded_motion import CommandedMotion, commanded_motion
from daq.recording.quality.command_quality import command_quality
from daq.recording.quality.signal_quality import ColumnQuality
from daq.recording.quality.stream_quality import StreamQuality
from daq.recording.recording import JOINTS_STREAM, MOTOR_SIGNALS, Recording
from daq.robot.loader import RobotFile
from daq.robot.schema import Robot
from drivers.core.errors import DataError, DynidError, RobotFileError, UsageError
from drivers.core.reading_process import Progress
from drivers.core.units import common_unit
from ident.assessment.command_checks import command_checks
from ident.assessment.delay.delay import DelaySearch, delay_checks, search_delay
from ident.assessment.excitation import ExcitationReached, RecordedMotion, excitation_reached, recorded_motion
from ident.assessment.recording_checks import column_qualities, recording_checks, stream_qualities, unsigned_signals
from ident.assessment.torque_level import torque_level_checks
from ident.excite.sufficiency import Sufficiency, TimesNeeded, motion_sufficiency, times_needed
from ident.regression.options import SIGNIFICANT_RSD
from ident.signals.options import PreprocessChoices
from ident.signals.resampling import check_rate
from ident.verdict.catalogue import raised
from ident.verdict.check import Check
from ident.verdict.verdict import Verdict, judge

GOOD_CONDITION = 50.0
SLOW_SHARE_PERCENT = 20.0
"""Beyond these a motion is worth improving: column-normalised condition number, utilisation of the velocity limit."""


LEAST_DETERMINED = 0.2
"""Share of the base parameters that a motion must determine (predicted RSD below `SIGNIFICANT_RSD`): those of TX40,
UR10 and Panda determine 0.30 to 0.31, 5 s of a simulated arm's 0.38 or more."""


@dataclass(frozen=True)
class RecordingInfo:
    """Everything that `dynid info` shows."""

    recording: Recording  # as read
    robot: Robot  # of the robot file
    streams: Mapping[str, StreamQuality]  # name → evenness of its clock
    columns: Mapping[tuple[str, str], tuple[ColumnQuality, ...]]  # (stream, quantity) → figures of its columns
    excitation: ExcitationReached | None  # how well the motion excites the arm; None where nothing could be analysed
    delay: DelaySearch | None  # torque behind position; None where there is no torque or no motion
    sufficiency: Sufficiency | None  # error bars expected from the motion; None where nothing could be analysed
    times: TimesNeeded | None  # how long it must last for a wanted RSD; None where none was requested
    verdict: Verdict  # the best possible suitability of a model from it, with all checks
    motion: RecordedMotion | None = None  # prepared as `dynid identify` would; None where nothing could be analysed

    @property
    def motion_units(self) -> tuple[str, str]:
        """Units of positions and velocities of its joints."""
        return common_unit("rad", self.robot.sliding), common_unit("rad/s", self.robot.sliding)


def recording_info(
    recording: Recording,
    robot_file: RobotFile,
    wanted_rsd_percent: float | None = None,
    progress: Progress = lambda step: None,
) -> RecordingInfo:
    """Analyse a recording's clocks, signals and motion.

    Raises:
        DataError: the stamps of the joints are not in seconds.
    """
    streams = stream_qualities(recording)
    if JOINTS_STREAM in streams:
        check_rate(streams[JOINTS_STREAM].rate_hz, f"{recording.label}: {JOINTS_STREAM}")
    progress("signals")
    columns = column_qualities(recording)
    progress("motion")
    excitation = delay = sufficiency = times = None
    motion, reason = None, ""
    try:
        motion = recorded_motion(recording, robot_file)
    except (DataError, UsageError, RobotFileError) as error:
        reason = error.message
    signed, commanded = _signed_signals(recording), _commanded(recording, robot_file.robot)
    if motion is not None:
        excitation = excitation_reached(motion)
        progress("delay")
        delay = _delay(motion)
        if signed or commanded is None:
            progress("expected error bars")
            sufficiency = motion_sufficiency(motion, _delays(motion, delay))
    if sufficiency is not None and wanted_rsd_percent is not None:
        times = times_needed(sufficiency, wanted_rsd_percent)
    progress("checks")
    checks = recording_checks(recording, streams, columns) + delay_checks(delay)
    if signed or commanded is None:
        checks += _excitation_checks(recording, excitation, reason) + _precision_checks(sufficiency)
    if not signed:
        checks += _without_torque_checks(recording, commanded)
    if motion is not None and motion.measured is not None:
        checks += torque_level_checks(robot_file, motion.model, motion.measured.torque)
    verdict = judge(checks, None)
    return RecordingInfo(
        recording, robot_file.robot, streams, columns, excitation, delay, sufficiency, times, verdict, motion
    )


def _signed_signals(recording: Recording) -> list[str]:
    """Motor signals of the joint stream that have a sign, as far as it is known."""
    stream = recording.streams.get(JOINTS_STREAM)
    channels = {} if stream is None else stream.channels
    lost = unsigned_signals(recording)
    return [name for name in MOTOR_SIGNALS if name in channels and not channels[name].magnitude and name not in lost]


def _commanded(recording: Recording, robot: Robot) -> CommandedMotion | None:
    try:
        return commanded_motion(recording, robot)
    except DataError:  # `identify` says why
        return None


def _without_torque_checks(recording: Recording, commanded: CommandedMotion | None) -> list[Check]:
    """Return what a recording without a signed torque is good for, and whether its commands are sound."""
    stream = recording.streams.get(JOINTS_STREAM)
    magnitudes = [name for name in MOTOR_SIGNALS if stream is not None and name in stream.channels]
    what = f"the {' and '.join(magnitudes)} has no sign" if magnitudes else "neither torque nor current is recorded"
    if commanded is None:
        return [raised("positions-alone", f"{what}, and no commanded position: nothing can be identified")]
    text = f"{what}: commands and encoder give a servo model (dynid identify --method servo), torques are not known"
    return [raised("no-torque", text), *command_checks(commanded, command_quality(commanded))]


def _delay(motion: RecordedMotion) -> DelaySearch | None:
    if motion.measured is None:  # `identify` says why
        return None
    try:
        return search_delay(motion.kernel, motion.prepared.segments, motion.prepared.parallel_filter)
    except DynidError:  # too short for an estimate
        return None


def _delays(motion: RecordedMotion, search: DelaySearch | None) -> PreprocessChoices | None:
    """The default preprocessing of the played motion with the delays that are used; None where there are none."""
    if search is None or not any(joint.used for joint in search.joints):
        return None
    chosen = motion.prepared.choices
    return PreprocessChoices(delay=search.used, joint_delays=search.joint_delays, start=chosen.start, stop=chosen.stop)


def _excitation_checks(recording: Recording, excitation: ExcitationReached | None, reason: str) -> list[Check]:
    """Check whether the motion shows the parameters; `reason` is why there is none."""
    if excitation is None:
        return [raised("no-motion", f"no motion to analyse: {reason}")]
    checks = []
    if excitation.unexcited:
        text = f"the motion does not excite {', '.join(excitation.unexcited)}"
        checks.append(raised("unexcited-parameters", text))
    if excitation.scaled_condition > GOOD_CONDITION:
        text = f"condition number {excitation.scaled_condition:.0f} is high (below {GOOD_CONDITION:g} is good)"
        checks.append(raised("high-condition", text))
    joints = recording.streams[JOINTS_STREAM].channels["position"].columns
    slow = [
        name
        for name, share in zip(joints, excitation.velocity_share_percent, strict=False)
        if share < SLOW_SHARE_PERCENT
    ]
    if slow:
        text = f"{', '.join(slow)} reach less than {SLOW_SHARE_PERCENT:g} % of their velocity limit"
        checks.append(raised("slow-motion", text, slow))
    return checks


def _precision_checks(sufficiency: Sufficiency | None) -> list[Check]:
    """Check whether the motion determines most parameters, by the error bars that it is expected to give."""
    rsds = [] if sufficiency is None else [parameter.rsd_percent for parameter in sufficiency.forecast.parameters]
    ratios = [ratio for ratio in rsds if ratio is not None]
    determined = sum(ratio < SIGNIFICANT_RSD for ratio in ratios)
    if determined >= LEAST_DETERMINED * len(ratios):
        return []
    text = (
        f"{determined} of {len(ratios)} base parameters are expected to be known within {SIGNIFICANT_RSD:g} %: record "
        "a more exciting motion, or longer"
    )
    return [raised("few-parameters-determined", text)]


def info_object(info: RecordingInfo, file: str) -> dict[str, Any]:
    """The JSON object of `dynid info --json`."""
    recording = info.recording
    return {
        "file": file,
        "robot": info.robot.name,
        "created": recording.created,
        "comment": recording.comment,
        "complete": recording.complete,
        "streams": {
            name: {
                **asdict(quality),
                "channels": {
                    quantity: {"unit": channel.unit, "columns": info.columns[name, quantity]}
                    for quantity, channel in recording.streams[name].channels.items()
                },
            }
            for name, quality in info.streams.items()
        },
        "excitation": info.excitation,
        "delay": info.delay,
        "sufficiency": _sufficiency_object(info),
        "verdict": info.verdict,
        "events": recording.events,
    }


def _sufficiency_object(info: RecordingInfo) -> dict[str, Any] | None:
    if info.sufficiency is None:
        return None
    content: dict[str, Any] = {
        "seconds": info.sufficiency.seconds,
        "source": info.sufficiency.source,
        "repetitions": info.sufficiency.repetitions,
        **asdict(info.sufficiency.forecast),
    }
    return content if info.times is None else {**content, "needed": info.times}
