"""The streams of an arm of CiA 402 drives before their first sample."""

from __future__ import annotations

from collections.abc import Sequence

from drivers.canopen402.samples.temperature import RATE as THERMAL_RATE
from drivers.streams import ChannelLayout, StreamLayout

_DESCRIPTIONS = {
    "position": "actual position (object 0x6064)",
    "velocity": "actual velocity, as the drive derives it (object 0x606C)",
    "current": "actual current, raw, in the joint's direction (object 0x6078 times the rated current)",
    "torque": "actual torque, as the drive derives it (object 0x6077 times the rated torque)",
}
_LATENESS_DESCRIPTION = "how much later than 'time' SYNC was sent; the drives measure at SYNC"
_STATUS_DESCRIPTION = "statusword of the drive (object 0x6041, CiA 402)"


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
