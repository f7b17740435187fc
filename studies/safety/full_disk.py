"""Where does a full disk leave a file? `python -m studies.safety.full_disk [tmpfs | ext4]` takes about six minutes.

The disk fills at every 4 KiB of an import and of a recording, each in a process of its own, over an old file. Without
a word it fills by a limit on the size of files (RLIMIT_FSIZE), as a quota would; with one, root mounts a small file
system and fills it. "Before": that much space is left when the file is created. "While": it is taken from a recording
that runs. The free space at which a recording is ended (16 MiB), and the extent in which it asks for space (8 MiB), are
set to 0 here, or little else would be tried.
Prints, per case, how the processes ended, and what was found of the old file and of the new one.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from daq.output_files import unfinished_files
from daq.recording import growing_file
from daq.recording import recorder as recorder_module
from daq.recording.reader import read_recording
from daq.recording.recorder import Recorder
from daq.recording.recover import follow_recording
from daq.robot.loader import load_robot
from drivers.core.errors import DynidError
from drivers.streams import Batch, ChannelLayout, StreamLayout
from dynid import command

STEP = int(os.environ.get("STEP", "4096"))
RATE = 500.0
SAMPLES = 1500
DISK = 32 * 2**20
OLD = b"old"
ARM = load_robot("ur5e")
NAMES = tuple(joint.name for joint in ARM.robot.joints)
LAYOUT = StreamLayout("joints", tuple(ChannelLayout(name, NAMES) for name in ("position", "current")), RATE)


@dataclass(frozen=True)
class Disk:
    """A folder on a disk: `work` holds the recordings; where it is mounted, `filler` takes all but so many bytes."""

    folder: Path
    mounted: bool

    @property
    def work(self) -> Path:
        return self.folder / "work"

    def leave(self, room: int) -> None:
        """Leave so many bytes, to the process that calls or on the disk."""
        if not self.mounted:
            resource.setrlimit(resource.RLIMIT_FSIZE, (room, resource.getrlimit(resource.RLIMIT_FSIZE)[1]))
            return
        about = os.statvfs(self.folder)
        taken = about.f_bavail * about.f_frsize - room
        with (self.folder / "filler").open("ab") as filler:
            while taken > 0:  # the file system may need some of it for itself
                try:
                    os.posix_fallocate(filler.fileno(), filler.tell(), taken)
                    return
                except OSError:
                    taken -= about.f_frsize

    def clear(self) -> None:
        """Give all space back."""
        for file in (*self.work.iterdir(), self.folder / "filler"):
            file.unlink(missing_ok=True)


@contextmanager
def disk_of(kind: str) -> Iterator[Path]:
    """A folder; on a small file system, unless the kind is `limit`."""
    with tempfile.TemporaryDirectory() as place:
        folder, image = Path(place) / "disk", Path(place) / "image"
        folder.mkdir()
        if kind == "ext4":
            image.write_bytes(bytes(DISK))
            subprocess.run(["mkfs.ext4", "-q", "-m", "0", image], check=True)
            subprocess.run(["mount", "-o", "loop", image, folder], check=True)
        elif kind == "tmpfs":
            subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={DISK}", "tmpfs", folder], check=True)
        try:
            (folder / "work").mkdir()
            yield folder
        finally:
            if kind != "limit":
                subprocess.run(["umount", folder], check=True)


def import_job(disk: Disk, room: int) -> None:
    """`dynid import --force` of a CSV outside the disk."""
    disk.leave(room)
    source = disk.folder.with_name("run.csv")
    sys.argv = ["dynid", "import", str(source), "--robot", "ur5e", "-o", str(disk.work / "run.h5"), "--force"]
    command.main()


def record_job(disk: Disk, room: int, *, late: bool) -> None:
    """A recorder with `--force`; the disk fills before it, or while it records."""
    if not late:
        disk.leave(room)
    recorder = Recorder(disk.work / "run.h5", ARM, (LAYOUT,), overwrite=True)
    if late:
        disk.leave(room)
    try:
        for first in range(0, SAMPLES, 100):
            time = (first + np.arange(100)) / RATE
            values = np.repeat(time[:, None], len(NAMES), axis=1)
            recorder.put(Batch("joints", time, time, {"position": values, "current": values}))
    finally:
        recorder.close(complete=True)


def outcome(job: Callable[[], None]) -> str:
    """How a process that does a job ends."""
    process = os.fork()
    if process == 0:
        for stream in (1, 2):
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream)
        status = 0
        try:
            job()
        except DynidError as error:
            status = error.exit_status
        except SystemExit as ended:
            status = int(ended.code or 0)
        except BaseException:
            status = 70
        sys.exit(status)  # at its exit HDF5 tries again what it could not write
    status = os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])
    return {0: "done", 1: "one line"}.get(status, f"CRASH {status}")


def found(path: Path) -> str:
    """What a recording is."""
    try:
        return f"whole ({len(read_recording(path).streams['joints'].time)})"
    except DynidError:
        pass
    try:
        return f"by recover ({len(follow_recording(path).streams['joints'].time)})"
    except DynidError:
        return "LOST"


def sweep(name: str, disk: Disk, job: Callable[[Disk, int], None], rooms: range) -> None:
    """Do a job at every room [B], and print what became of it."""
    ends: Counter[str] = Counter()
    old_lost = 0
    fewest: dict[str, int] = {}
    for room in rooms:
        disk.clear()
        path = disk.work / "run.h5"
        path.write_bytes(OLD)
        end = outcome(partial(job, disk, room))
        old_stands = path.exists() and path.read_bytes() == OLD
        kept = [found(file) for file in unfinished_files(path)] or ["nothing"]
        if not old_stands:
            kept = [found(path)] if path.exists() else ["nothing"]
        old_lost += not old_stands and (end != "done" or kept[0] == "nothing")
        kind, _, samples = kept[0].partition(" (")
        ends[f"{end}, {'old' if old_stands else 'new'} file, {kind}"] += 1
        if samples:
            count = int(samples.rstrip(")"))
            fewest[kind] = min(fewest.get(kind, count), count)
    crashes = sum(count for end, count in ends.items() if "CRASH" in end)
    print(f"{name}: {len(rooms)} steps, {crashes} crashes, {old_lost} old files lost")
    for end, count in sorted(ends.items()):
        print(f"    {count:>5}  {end}")
    print(f"           fewest samples: {fewest}", flush=True)


def sweeps(kind: str, folder: Path) -> None:
    """All sweeps on a disk. Each job runs in a fork, whose end must find nothing to clean up: so this is a process."""
    recorder_module.RESERVE = growing_file.EXTENT = 0
    disk = Disk(folder, kind != "limit")
    sweep(f"import, {kind}", disk, import_job, range(0, 300_000, STEP))
    early = range(0, growing_file.SPARE + 500_000, STEP)
    sweep(f"recording, before, {kind}", disk, lambda disk, room: record_job(disk, room, late=False), early)
    if disk.mounted:  # a limit of size would take back space that was granted, which no disk does
        sweep(
            f"recording, while, {kind}",
            disk,
            lambda disk, room: record_job(disk, room, late=True),
            range(0, 500_000, STEP),
        )


def main(kind: str) -> None:
    """Make the disk and the file to import, and sweep."""
    with disk_of(kind) as folder:
        header = ["t", *(f"{name}{joint}" for name in ("q", "current") for joint in range(1, 7))]
        time = np.arange(SAMPLES) / RATE
        rows = np.column_stack([time, np.tile(np.sin(time)[:, None], 12)])
        np.savetxt(folder.with_name("run.csv"), rows, delimiter=",", header=",".join(header), comments="")
        subprocess.run([sys.executable, "-m", "studies.safety.full_disk", kind, str(folder)], check=True)


if __name__ == "__main__":
    arguments = sys.argv[1:] or ["limit"]
    if len(arguments) == 2:
        sweeps(arguments[0], Path(arguments[1]))
    else:
        main(arguments[0])
