"""The command `dynid record`, from its arguments to its exit status, with a driver of an arm that is not there."""

from __future__ import annotations

import io
import json
import os
import pty
import re
import signal
import subprocess
import sys
import threading
from contextlib import nullcontext, suppress
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from kinematic_arm import FIRST_STAMP, NAMES, RATE, ROBOT_FILE, KinematicArm
from record_process import IN_REAL_TIME, IN_SIMULATED_TIME, LIMIT, ROOT, SUPPORT, in_a_process, wait_for

from daq.motion.player import MotionSequence
from daq.motion.trajectory_file import load_trajectory
from daq.recording.growing_file import SPARE
from daq.recording.reader import read_recording
from daq.recording.recover import follow_recording, half_written
from drivers import declaration
from drivers.canopen402.declaration import DECLARATION as DRIVES
from drivers.core.errors import RecordingError

TRAJECTORY = {
    "robot": "two-links",
    "kind": "points",
    "points": [[0.1, -0.1], [0.3, 0.1], [0.0, 0.0]],
    "durations": [0.8, 0.8],
}


@pytest.fixture
def bench(tmp_path, monkeypatch):
    """A folder with robot file and trajectory, and the driver `kinematic` installed."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "robot.yaml").write_text(ROBOT_FILE.text)
    (tmp_path / "traj.yaml").write_text(yaml.safe_dump(TRAJECTORY))
    made = []

    def install(fault="", name="kinematic", known=None):
        def make(settings):
            made.append((settings, KinematicArm(fault, 0.802, clock=settings.clock)))
            return made[-1][1]

        found = declaration.DriverDeclaration(make) if known is None else replace(known, driver=make)
        entry = SimpleNamespace(name=name, load=lambda: found)
        monkeypatch.setattr(declaration, "entry_points", lambda group: [entry])

    install()
    return SimpleNamespace(folder=tmp_path, made=made, install=install)


@pytest.fixture
def dynid(clock, monkeypatch, run_dynid):
    """The command in simulated time."""
    monkeypatch.setattr("drivers.core.clock.SYSTEM_CLOCK", clock)
    return run_dynid


@pytest.mark.parametrize("as_json", [False, True])
def test_a_recording_with_heavy_loss_says_so_last_and_fails(bench, dynid, monkeypatch, as_json):
    read = KinematicArm.read

    def read_lossy(self, timeout):
        return tuple(replace(block, lost=1) for block in read(self, timeout))

    monkeypatch.setattr(KinematicArm, "read", read_lossy)
    options = ["--json"] if as_json else []
    status, out, err = dynid("record", "robot.yaml", "--duration", "1", "-o", "run.h5", *options)
    assert status == 1
    said = err.splitlines()[-1]
    assert "samples of joints were lost: " in said
    if as_json:
        assert said.startswith(f"dynid: {json.loads(out)['heavy_loss']}: ")


def test_a_motion_is_recorded_and_told_as_json(bench, dynid):
    status, out, err = dynid(
        "record", "robot.yaml", "--trajectory", "traj.yaml", "--yes", "-o", "run.h5", "--comment", "cold", "--json"
    )
    assert status == 0, err
    told = json.loads(out)
    recording = read_recording(bench.folder / "run.h5")
    settings, arm = bench.made[0]
    joints = recording.streams["joints"]
    np.testing.assert_array_equal(joints.time, np.concatenate([block.time for block in arm.samples]))
    assert told["file"] == "run.h5"
    assert told["stopped_by"] is None
    assert told["overflow"] == 0
    assert told["streams"]["joints"]["samples"] == len(joints.time) == arm.count
    assert told["streams"]["joints"]["lost"] == 0
    assert told["streams"]["joints"]["rate_hz"] == pytest.approx(RATE, rel=1e-6)
    path = MotionSequence([load_trajectory(Path("traj.yaml"), ROBOT_FILE.robot).motion], RATE)
    positions = path.positions(np.arange(round(path.duration * RATE) + 1) / RATE)
    end = 1 + int(np.flatnonzero(np.any(np.diff(arm.commands, axis=0), axis=1))[-1])  # held after it
    np.testing.assert_allclose(arm.commands[end - len(positions) + 2 : end + 1], positions[1:], rtol=0, atol=1e-12)
    assert told["punctuality"]["sent"] < len(arm.commands)
    assert told["punctuality"]["skipped"] == 0
    assert recording.complete
    assert recording.comment == "cold"
    assert settings.joints == NAMES
    assert arm.stopped_at is not None


def test_what_the_controller_is_known_for_is_told_before_a_motion_and_kept(bench, dynid, monkeypatch):
    monkeypatch.setattr(KinematicArm, "cautions", lambda self: ["elbow: its quick stop coasts"], raising=False)
    options = ("--trajectory", "traj.yaml", "--yes", "-o", "run.h5")
    status, out, err = dynid("record", "robot.yaml", *options)
    assert status == 0, err
    assert "note about this arm's controller or drives:\n  elbow: its quick stop coasts\n" in out
    events = read_recording(bench.folder / "run.h5").events
    assert ("warning", "elbow: its quick stop coasts") in [(event.level, event.message) for event in events]
    assert "coasts" not in dynid("record", "robot.yaml", "--duration", "0.1", "-o", "still.h5")[1]


def test_streams_are_told_as_info_tells_them(bench, dynid):
    status, out, _ = dynid("record", "robot.yaml", "--duration", "0.6", "-o", "run.h5", "--json")
    assert status == 0
    streams = json.loads(out)["streams"]
    status, out, _ = dynid("info", "run.h5", "--json")
    assert status == 0
    info = json.loads(out)["streams"]
    assert streams.keys() == info.keys()
    for name, quality in streams.items():
        assert quality == {key: info[name][key] for key in quality}


def test_without_json_a_person_is_told(bench, dynid):
    status, out, err = dynid("record", "robot.yaml", "--duration", "0.6", "-o", "run.h5", "--host", "192.0.2.7")
    assert status == 0
    assert "run.h5: joints: 120 samples at 200 Hz, 0 lost" in out
    assert err == ""  # no terminal: no display
    assert bench.made[0][0].connection["host"] == "192.0.2.7"


CANOPEN = """
connections:
  arm:
    driver: canopen402
    interface: virtual
    channel: nowhere
    bitrate: {bitrate}
    sync_rate: 200
    nodes: {{shoulder: {{id: 1}}, elbow: {{id: 2}}}}
"""


def on_canopen(bench, bitrate):
    """The robot file with a CANopen connection, and that driver in place of the real one."""
    content = yaml.safe_load(ROBOT_FILE.text) | yaml.safe_load(CANOPEN.format(bitrate=bitrate))
    (bench.folder / "robot.yaml").write_text(yaml.safe_dump(content))
    bench.install(name="canopen402", known=DRIVES)


def test_a_bus_that_is_too_slow_is_refused_before_it_is_touched(bench, dynid):
    on_canopen(bench, 100000)
    status, out, err = dynid("record", "robot.yaml", "--duration", "0.3", "-o", "run.h5")
    assert status == 2
    assert out == ""
    (line,) = err.splitlines()
    assert "connections.arm: 200 Hz does not fit on a bus of 100000 bit/s" in line
    assert not (bench.folder / "run.h5").exists()
    assert not any(arm.opened for _, arm in bench.made)


def test_a_bus_with_little_room_is_a_warning_on_stderr_and_in_the_file(bench, dynid):
    on_canopen(bench, 138000)
    status, _, err = dynid("record", "robot.yaml", "--duration", "0.3", "-o", "run.h5")
    assert status == 0
    assert "dynid: warning: connection 'arm' fills its bus to 8" in err
    (event,) = [event for event in read_recording(bench.folder / "run.h5").events if "fills its bus" in event.message]
    assert event.level == "warning"


def test_no_display_is_started_for_programs(bench, dynid, monkeypatch):
    displays = []

    def noted(*, shown, **others):
        displays.append(shown)
        return nullcontext()

    monkeypatch.setattr("daq.live.terminal_view.live_view", noted)
    for terminal in (True, False):
        for option in ((), ("--no-ui",), ("--json",)):
            monkeypatch.setattr(sys.stderr, "isatty", lambda terminal=terminal: terminal)
            assert dynid("record", "robot.yaml", "--duration", "0.1", "-o", "run.h5", "--force", *option)[0] == 0
    assert displays == [True, False, False, False, False, False]


@pytest.mark.parametrize("fault", ["torque", "temperature", "protective stop", "lost connection"])
def test_a_stopped_session_exits_1_with_the_reason(bench, dynid, fault):
    bench.install(fault)
    status, out, err = dynid("record", "robot.yaml", "--trajectory", "traj.yaml", "--yes", "-o", "run.h5", "--json")
    assert status == 1
    reason = "the connection broke" if fault == "lost connection" else fault
    told = json.loads(out)
    assert reason in told["stopped_by"]
    assert reason in err
    seen = 160 if fault == "lost connection" else 161
    assert told["streams"]["joints"]["samples"] == bench.made[0][1].count == seen
    assert not read_recording(bench.folder / "run.h5").complete
    assert bench.made[0][1].commands_after_stop == 0


def refused(bench, dynid, *arguments):
    """What is said about arguments that are refused; nothing was done."""
    before = {path.name: path.read_bytes() for path in bench.folder.iterdir()}
    status, out, _ = dynid("record", "robot.yaml", *arguments, "--json")
    assert status == 2
    assert {path.name: path.read_bytes() for path in bench.folder.iterdir()} == before
    assert all(arm.commands == [] for _, arm in bench.made)
    error = json.loads(out)
    return f"{error['where']}: {error['error']} ({error['hint']})"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((), "either --trajectory or --duration"),
        (("--trajectory", "traj.yaml", "--duration", "1"), "either --trajectory or --duration"),
        (("--duration", "0"), "--duration 0 is not within"),
        (("--duration", "nan"), "--duration nan is not a finite number"),
        (("--duration", "1", "--wire", "canfd"), "no connection is called 'canfd' (there are: bench)"),
        (("--trajectory", "absent.yaml"), "absent.yaml: no such file"),
    ],
)
def test_wrong_arguments_exit_2(bench, dynid, arguments, said):
    assert said in refused(bench, dynid, *arguments, "-o", "run.h5")
    assert bench.made == []


@pytest.mark.parametrize(
    ("change", "said"),
    [({"robot": "ur5e"}, "made for 'ur5e'"), ({"points": [[0.1, -0.1], [3.5, 0.1], [0.0, 0.0]]}, "shoulder")],
)
def test_a_trajectory_that_does_not_fit_exits_2(bench, dynid, change, said):
    (bench.folder / "traj.yaml").write_text(yaml.safe_dump(TRAJECTORY | change))
    assert said in refused(bench, dynid, "--trajectory", "traj.yaml", "--yes", "-o", "run.h5")
    assert bench.made == []


def test_a_robot_without_connections_exits_2(bench, dynid):
    (bench.folder / "robot.yaml").write_text(ROBOT_FILE.text.partition("connections:")[0])
    assert "has no connection" in refused(bench, dynid, "--duration", "1", "-o", "run.h5")


def test_a_driver_that_is_not_installed_exits_2(bench, dynid):
    bench.install(name="other")
    said = refused(bench, dynid, "--duration", "1", "-o", "run.h5")
    assert "connections.bench.driver: no driver is called 'kinematic' (installed: other)" in said


@pytest.mark.parametrize(
    ("out", "said"),
    [
        (
            "there.h5",
            "there.h5: exists already (choose another name, or overwrite it: --force, in Python overwrite=True)",
        ),
        ("nowhere/run.h5", "nowhere: there is no such folder"),
        ("there.h5/run.h5", "there.h5: is not a folder"),
        (".", ".: is a folder"),
    ],
)
def test_where_nothing_can_be_written_is_known_before_the_wire_is_touched(bench, dynid, out, said):
    (bench.folder / "there.h5").write_bytes(b"precious")
    assert said in refused(bench, dynid, "--duration", "1", "-o", out)
    assert not any(arm.opened for _, arm in bench.made)


def test_a_full_disk_is_known_before_the_wire_is_touched(bench, dynid, monkeypatch):
    monkeypatch.setattr("daq.recording.recorder.RESERVE", 2**62)
    status, out, _ = dynid("record", "robot.yaml", "--duration", "1", "-o", "run.h5", "--json")
    assert status == 1
    assert "the disk is full" in json.loads(out)["error"]
    assert not any(arm.opened for _, arm in bench.made)


PLAY = ("record", "robot.yaml", "--trajectory", "traj.yaml", "-o", "run.h5")
TABLE = "floor: 0.21"
"""0.03 m below the links of `two-links` (0.3 m up, 0.05 m thick) with a tool of 0.1 m that dips by 0.1 rad."""
TOOL = "tool: [0.1, 0, 0]"


def with_workspace(bench, *lines):
    text = ROBOT_FILE.text.replace("connections:", "\n  ".join(["workspace:", *lines]) + "\nconnections:")
    (bench.folder / "robot.yaml").write_text(text)


@pytest.fixture
def keyboard(monkeypatch):
    """A terminal: what is written into the first, and the prompt's output."""
    reading, writing = os.pipe()
    shown = io.StringIO()
    with os.fdopen(reading) as typed, os.fdopen(writing, "w", buffering=1) as keys:
        monkeypatch.setattr("daq.commands.confirmation.terminal", lambda: (typed, shown))
        yield SimpleNamespace(type=lambda text: print(text, file=keys, flush=True), shown=shown, close=keys.close)


def test_without_a_terminal_the_arm_moves_only_with_yes(bench, dynid):
    status, out, err = dynid(*PLAY)
    assert (status, out) == (2, "")
    assert err == "dynid: the arm will move, and there is no terminal to ask on (--yes moves it without asking)\n"
    assert bench.made == []
    assert not (bench.folder / "run.h5").exists()


def test_an_arm_that_tells_nothing_of_its_stops_moves_on_request_alone_and_the_question_says_so(
    bench, dynid, keyboard, monkeypatch
):
    silent = type("SilentArm", (KinematicArm,), {"unreported": lambda self: ("safety_mode",)})
    monkeypatch.setitem(globals(), "KinematicArm", silent)
    record = ("record", "robot.yaml", "--trajectory", "traj.yaml", "-o", "run.h5")
    status, _, err = dynid(*record, "--yes")
    assert (status, bench.made[0][1].commands) == (2, [])
    assert "does not deliver safety_mode" in err
    assert not list(bench.folder.glob("run*"))
    keyboard.type("y")
    status, out, err = dynid(*record, "--without-safety-status")
    assert status == 0, err
    assert "note about this arm's controller or drives:\n  the controller does not deliver safety_mode" in out
    assert "dynid: warning: the controller does not deliver safety_mode" in err
    warnings = [event.message for event in read_recording(bench.folder / "run.h5").events if event.level == "warning"]
    assert any("does not deliver safety_mode" in warning for warning in warnings)
    status, _, err = dynid("record", "robot.yaml", "--duration", "1", "-o", "rest.h5", "--without-safety-status")
    assert (status, "needs --trajectory" in err) == (2, True)


@pytest.mark.parametrize("word", ["y", "Yes"])
def test_what_will_move_where_is_told_and_a_yes_moves_it(bench, dynid, keyboard, word):
    with_workspace(bench, TABLE, TOOL)
    keyboard.type(word)
    status, out, err = dynid(*PLAY)
    assert status == 0, err
    assert keyboard.shown.getvalue() == "Move the arm? [y/N] "
    told = out.splitlines()
    assert told[0] == "traj.yaml moves two-links for 1.6 s"
    assert re.match(r"  tool point: lowest 0\.\d+ m .*, farthest 0\.5\d\d m from it, at most 0\.\d\d m/s$", told[1])
    assert any(re.match(r"  smallest clearance to the table: 0\.030 m \(link elbow, at ", line) for line in told)
    assert any(line.startswith("first the approach to the start pose, 0.1 s") for line in told)
    assert len(bench.made[0][1].commands) > 100


@pytest.mark.parametrize("word", ["n", "", "yep"])
def test_any_other_answer_moves_nothing_and_leaves_no_file(bench, dynid, keyboard, word):
    keyboard.type(word)
    status, _, err = dynid(*PLAY)
    assert (status, err.splitlines()[-1]) == (2, "dynid: not confirmed, so nothing was moved")
    arm = bench.made[0][1]
    assert (arm.commands, arm.stopped_at is not None) == ([], True)
    assert not list(bench.folder.glob("run*"))


def test_an_older_recording_is_not_lost_by_a_no(bench, dynid, keyboard):
    (bench.folder / "run.h5").write_text("old")
    keyboard.type("n")
    assert dynid(*PLAY, "--force")[0] == 2
    assert [file.read_text() for file in bench.folder.glob("run*")] == ["old"]


def test_the_end_of_the_input_is_no_yes(bench, dynid, keyboard):
    keyboard.close()
    assert dynid(*PLAY)[0] == 2
    assert bench.made[0][1].commands == []


def test_a_trajectory_that_comes_too_near_is_refused_before_the_wire_is_touched(bench, dynid):
    with_workspace(bench, "keep_out: [{name: crate, box: {lower: [0.35, 0, 0.2], upper: [0.5, 0.3, 0.4]}}]")
    status, out, err = dynid(*PLAY, "--yes")
    assert (status, out) == (2, "")
    assert re.match(r"dynid: traj\.yaml: link \w+ enters crate at \d\.\d\d s, up to 0\.\d+ m deep", err)
    assert len(err.splitlines()) == 1
    assert not any(arm.opened for _, arm in bench.made)


def test_a_way_to_the_start_that_comes_too_near_is_refused_and_moves_nothing(bench, dynid):
    # The arm waits behind a thin wall that the trajectory, beyond it, does not touch.
    points = [[1.6, 0.0], [1.7, 0.1], [1.6, 0.0]]
    (bench.folder / "traj.yaml").write_text(yaml.safe_dump(TRAJECTORY | {"points": points}))
    with_workspace(bench, "keep_out: [{name: wall, box: {lower: [0.2, 0.2, 0], upper: [0.22, 0.6, 0.6]}}]")
    status, _, err = dynid(*PLAY, "--yes")
    assert status == 2
    assert "the approach to the start pose: link" in err
    assert "enters wall" in err
    assert "move the arm nearer to the start pose" in err
    assert bench.made[0][1].commands == []
    assert not (bench.folder / "run.h5").exists()


def test_a_first_run_is_slow_and_recorded_as_such(bench, dynid):
    status, out, err = dynid(*PLAY, "--yes", "--speed-scale", "0.25", "--json")
    assert status == 0, err
    assert json.loads(out)["motion"]["duration"] == pytest.approx(1.6 / 0.25)
    recording = read_recording(bench.folder / "run.h5")
    assert recording.speed_scale == 0.25
    assert any(event.message == "the trajectory is played at 0.25 of its speed" for event in recording.events)
    assert yaml.safe_load(recording.trajectory) == TRAJECTORY
    commands = np.array(bench.made[0][1].commands)
    fast = load_trajectory(Path("traj.yaml"), ROBOT_FILE.robot).motion
    time = np.arange(int(1.6 / 0.25 * RATE) + 1) / RATE
    end = 2 + int(np.flatnonzero(np.any(np.diff(commands, axis=0), axis=1))[-1])  # held after it
    np.testing.assert_allclose(commands[end - len(time) : end], fast.evaluate(0.25 * time)[0].T, atol=1e-12)


@pytest.mark.parametrize("scale", ["0", "1.5", "nan", "-1"])
def test_a_speed_scale_that_is_no_share_exits_2(bench, dynid, scale):
    said = refused(bench, dynid, *PLAY[2:], "--yes", "--speed-scale", scale)
    assert ("is not a finite number" if scale == "nan" else "is not above 0 and at most 1") in said
    assert "need --trajectory" in refused(bench, dynid, "--duration", "1", "--speed-scale", "0.5", "-o", "run.h5")


@pytest.mark.parametrize(("beyond", "old"), [(300_000, False), (370_000, True)])
def test_a_write_that_the_system_refuses_ends_in_order(bench, beyond, old):
    """A file size limit, as a quota would: there is room on the disk, yet the file gets no space to grow."""
    trajectory = ("--trajectory", "traj.yaml", "--yes", "-o", "run.h5", "--json", "--force")
    (bench.folder / "traj.yaml").write_text(yaml.safe_dump(TRAJECTORY | {"durations": [9.0, 9.0]}))
    if old:
        (bench.folder / "run.h5").write_text("old")
    process = in_a_process(IN_SIMULATED_TIME.format(limit=SPARE + beyond), bench.folder, *trajectory)
    out, errors = process.communicate(timeout=LIMIT)
    assert process.returncode == 1, errors
    said = "run.h5: cannot be written: File too large (free some space on the disk, or choose another place)"
    assumed, *others = errors.splitlines()
    assert assumed.startswith("dynid: warning: assumed: acceleration limit 10 rad/s²")
    told = json.loads(out)
    assert told["stopped_by"] == said
    assert (bench.folder / "arm.txt").read_text() == "True True 0\n"
    if old:  # it is not given up for one that was cut short
        assert others == [f"dynid: {said}", f"dynid: run.h5 is as it was; what was recorded is {told['file']}"]
        assert (bench.folder / "run.h5").read_text() == "old"
    else:
        assert (others, told["file"]) == ([f"dynid: {said}"], "run.h5")
    recording = read_recording(bench.folder / told["file"])
    joints = recording.streams["joints"]
    assert not recording.complete
    assert len(joints.time) > 0
    np.testing.assert_array_equal(joints.time, FIRST_STAMP + np.arange(len(joints.time)) / 2000.0)
    for channel in joints.channels.values():
        assert np.all(np.isfinite(channel.values))


def test_a_limit_that_leaves_no_room_for_a_file_is_refused(bench):
    process = in_a_process(IN_SIMULATED_TIME.format(limit=5000), bench.folder, "--duration", "1", "-o", "run.h5")
    out, errors = process.communicate(timeout=LIMIT)
    assert (process.returncode, out) == (1, "")
    assert errors.startswith("dynid: run.h5: ")
    assert "File too large" in errors
    assert not list(bench.folder.glob("run*"))


@pytest.mark.realtime
def test_sigterm_ends_in_order_with_the_status_of_shells(bench):
    process = in_a_process(IN_REAL_TIME, bench.folder, "--duration", "600", "-o", "run.h5", "--json")
    wait_for((bench.folder / "begun").exists, process)
    process.terminate()
    out, errors = process.communicate(timeout=LIMIT)
    assert process.returncode == 128 + signal.SIGTERM == 128 + signal.SIGTERM
    assert errors == "dynid: terminated\n"
    assert json.loads(out)["stopped_by"] == "terminated"
    assert (bench.folder / "arm.txt").read_text() == "False True 0\n"
    assert any(event.message == "stopped: terminated" for event in read_recording(bench.folder / "run.h5").events)


@pytest.mark.realtime
def test_what_was_flushed_before_a_kill_is_rescued_by_the_command(bench, dynid):
    process = in_a_process(IN_REAL_TIME, bench.folder, "--duration", "600", "-o", "run.h5")
    path, flushed = bench.folder / "run.h5", 0

    def grown() -> bool:
        nonlocal flushed
        with suppress(RecordingError):  # its beginning is being written
            flushed = len(follow_recording(half_written(path)).streams["joints"].time)
        return flushed >= 100

    wait_for((bench.folder / "begun").exists, process)
    wait_for(grown, process)
    process.kill()
    process.communicate(timeout=LIMIT)
    assert process.returncode == -signal.SIGKILL
    with pytest.raises(RecordingError, match=r"half-written.*dynid recover"):
        read_recording(half_written(path))
    status, out, _ = dynid("recover", "run.h5", "--json")
    assert status == 0
    recording = read_recording(bench.folder / "run-recovered.h5")
    times = recording.streams["joints"].time
    assert json.loads(out)["streams"]["joints"]["samples"] == len(times) >= flushed
    np.testing.assert_array_equal(times, FIRST_STAMP + np.arange(len(times)) / RATE)
    assert not recording.complete


IN_A_TERMINAL = """
import fcntl, sys, termios
from types import SimpleNamespace

def main():
    fcntl.ioctl(0, termios.TIOCSCTTY, 0)
    sys.path.insert(0, sys.argv.pop(1))
    from kinematic_arm import KinematicArm
    from drivers import declaration
    from dynid import command
    driver = declaration.DriverDeclaration(lambda settings: KinematicArm())
    entry = SimpleNamespace(name="kinematic", load=lambda: driver)
    declaration.entry_points = lambda group: [entry]
    command.main()

if __name__ == "__main__":
    main()
"""


@pytest.mark.realtime
def test_ctrl_c_in_a_terminal_ends_recording_and_display_in_order(bench):
    keyboard, terminal = pty.openpty()
    arguments = ("record", "robot.yaml", "--duration", "600", "-o", "run.h5")
    process = subprocess.Popen(
        [sys.executable, "-c", IN_A_TERMINAL, str(SUPPORT), *arguments],
        stdin=terminal,
        stdout=terminal,
        stderr=terminal,
        start_new_session=True,
        env={**os.environ, "PYTHONPATH": str(ROOT), "TERM": "xterm", "COLUMNS": "120"},
    )
    os.close(terminal)
    patience = threading.Timer(LIMIT, process.kill)
    patience.start()
    seen, sent = b"", False
    with suppress(OSError):  # how Linux says that nobody holds the terminal any more
        while received := os.read(keyboard, 65536):
            seen += received
            if not sent and seen.count(b" Hz, ") >= 4:
                sent = os.write(keyboard, b"\x03") == 1  # to the display, too
    status = process.wait()
    patience.cancel()
    os.close(keyboard)
    text = seen.decode(errors="replace")
    assert sent, text
    assert status == 130, text
    assert "Traceback" not in text
    assert "of 600.0 s" in text
    assert "largest torque so far 10 % of its limit (shoulder)" in text
    recording = read_recording(bench.folder / "run.h5")
    assert any("stopped: interrupted" in event.message for event in recording.events)
