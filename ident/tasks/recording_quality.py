"""The quality of a recording in one call: clocks, signals, and how well its motion excites the arm."""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike

from daq.robot.loader import load_robot
from drivers.core.options import keywords_of
from drivers.core.text import json_text
from ident.checks.page.page import render_page
from ident.checks.recording_check import RecordingInfo, info_object, recording_info
from ident.checks.recording_tables import motion_table, stream_table
from ident.result.tables import Table
from ident.tasks.arguments import SavedResult, recording_of
from ident.tasks.options import InfoOptions
from ident.verdict.verdict import Verdict


@dataclass(frozen=True)
class RecordingQuality(SavedResult):
    """Clocks, signals and excitation of a recording; shows itself in a notebook, and is saved as the command saves it.

    Attributes:
        file: what the recording is called.
        figures: all that was found.

    Example:
        >>> import dynid
        >>> quality = dynid.info(dynid.simulate("ur5e", duration=10.0, seed=1))
        >>> quality.streams.row("joints")["lost"]
        0
    """

    FILE = "info.json"
    PAGE = "info.html"

    file: str
    figures: RecordingInfo

    @property
    def verdict(self) -> Verdict:
        """Return what a model that is identified from it can be good for, at best, with all checks."""
        return self.figures.verdict

    @property
    def streams(self) -> Table:
        """A row per stream: samples, duration [s], rate [Hz], jitter [ms], samples lost, duplicate stamps."""
        return stream_table(self.figures, self.file)

    @property
    def motion(self) -> Table:
        """A row per joint: range of positions [rad], velocity reached [rad/s], utilisation of its limit [%].

        Without rows where there is no motion to analyse.
        """
        return motion_table(self.figures)

    def _page(self) -> str:
        return render_page(self.figures, self.file)

    def to_json(self) -> str:
        """Return what `dynid info --json` prints."""
        return json_text(info_object(self.figures, self.file))

    def __repr__(self) -> str:
        return f"<dynid.RecordingQuality of {self.file}: {self.verdict.headline}>"

    def _parts(self) -> tuple[object, ...]:
        return self.verdict, self.streams, self.motion


@keywords_of(InfoOptions)
def info(options: InfoOptions) -> RecordingQuality:
    """Look at a recording's streams, clock and signal quality, and at how well its motion excites the arm.

    Raises:
        RecordingError: it cannot be read.
        UsageError: `wanted_rsd` is not a percentage.
        DataError: the stamps of the joints are not in seconds.

    Example:
        >>> import dynid
        >>> quality = dynid.info(dynid.simulate("ur5e", duration=10.0, seed=1), wanted_rsd=5.0)
        >>> quality.figures.times.wanted_rsd_percent
        5.0
    """
    options.progress("reading")
    run = options.run
    recording = recording_of(run)
    robot_file = recording.robot() if options.robot is None else load_robot(options.robot)
    file = str(run) if isinstance(run, (str, PathLike)) else recording.label
    return RecordingQuality(file, recording_info(recording, robot_file, options.wanted_rsd, options.progress))
