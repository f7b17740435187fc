"""The command `dynid record`, from its arguments to its exit status, with a driver of an arm that is not there."""

from __future__ import annotations

import json
import os
import pty
import subprocess
import sys
import threading
from contextlib import nullcontext, suppress
from pathlib import Path
from types import SimpleNamespace

import pytest
import yaml
from kinematic_arm import RATE, ROBOT_FILE, KinematicArm

from daq import session
from daq.recording import read_recording
from drivers import command

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

    def install(fault="", name="kinematic"):
        def make(settings):
            made.append((settings, KinematicArm(fault)))
            return made[-1][1]

        entry = SimpleNamespace(name=name, load=lambda: make)
        monkeypatch.setattr(session, "entry_points", lambda group: [entry])

    install()
    return SimpleNamespace(folder=tmp_path, made=made, install=install)


@pytest.fixture
def dynid(monkeypatch, capsys):
    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["dynid", *arguments])
        with pytest.raises(SystemExit) as left:
            command.main()
        out, err = capsys.readouterr()
        return left.value.code, out, err

    return run


def test_a_motion_is_recorded_and_told_as_json(bench, dynid):
    status, out, err = dynid(
        "record", "robot.yaml", "--trajectory", "traj.yaml", "-o", "run.h5", "--comment", "cold", "--json"
    )
    assert status == 0, err
    told = json.loads(out)
    recording = read_recording(bench.folder / "run.h5")
    samples = len(recording.streams["joints"].time)
    assert told["file"] == "run.h5"
    assert told["stopped_by"] is None
    assert told["overflow"] == 0
    assert told["streams"]["joints"]["samples"] == samples > 1.5 * RATE
    assert told["streams"]["joints"]["lost"] == 0
    assert told["streams"]["joints"]["rate_hz"] == pytest.approx(RATE, rel=1e-6)
    assert told["punctuality"]["sent"] > 1.5 * RATE
    assert recording.complete
    assert recording.comment == "cold"
    settings, arm = bench.made[0]
    assert settings.joints == ("shoulder", "elbow")
    assert arm.stopped_at is not None


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
    assert "samples at 200 Hz, 0 lost" in out
    assert err == ""  # no terminal: no display
    assert bench.made[0][0].connection["host"] == "192.0.2.7"


def test_no_display_is_started_for_programs(bench, dynid, monkeypatch):
    displays = []

    def noted(*, shown, **others):
        displays.append(shown)
        return nullcontext()

    monkeypatch.setattr("daq.live_view.live_view", noted)
    for terminal in (True, False):
        for option in ((), ("--no-ui",), ("--json",)):
            monkeypatch.setattr(sys.stderr, "isatty", lambda terminal=terminal: terminal)
            assert dynid("record", "robot.yaml", "--duration", "0.1", "-o", "run.h5", "--force", *option)[0] == 0
    assert displays == [True, False, False, False, False, False]


@pytest.mark.parametrize("fault", ["torque", "temperature", "protective stop", "lost connection"])
def test_a_stopped_session_exits_1_with_the_reason(bench, dynid, fault):
    bench.install(fault)
    status, out, err = dynid("record", "robot.yaml", "--trajectory", "traj.yaml", "-o", "run.h5", "--json")
    assert status == 1
    reason = "the connection broke" if fault == "lost connection" else fault
    told = json.loads(out)
    assert reason in told["stopped_by"]
    assert reason in err
    assert told["streams"]["joints"]["samples"] > 0
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
        (("--duration", "0"), "not a positive number"),
        (("--duration", "nan"), "not a positive number"),
        (("--duration", "1", "--wire", "canfd"), "no connection is called 'canfd' (there are: bench)"),
        (("--trajectory", "absent.yaml"), "absent.yaml: cannot be read"),
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
    assert said in refused(bench, dynid, "--trajectory", "traj.yaml", "-o", "run.h5")
    assert bench.made == []


def test_a_robot_without_connections_exits_2(bench, dynid):
    (bench.folder / "robot.yaml").write_text(ROBOT_FILE.text.partition("connections:")[0])
    assert "has no connection" in refused(bench, dynid, "--duration", "1", "-o", "run.h5")


def test_a_driver_that_is_not_installed_exits_2(bench, dynid):
    bench.install(name="other")
    said = refused(bench, dynid, "--duration", "1", "-o", "run.h5")
    assert "connections.bench.driver: no driver is called 'kinematic' (installed: other)" in said


def test_an_existing_file_is_kept(bench, dynid):
    (bench.folder / "run.h5").write_bytes(b"precious")
    assert "run.h5" in refused(bench, dynid, "--duration", "1", "-o", "run.h5")
    assert bench.made[0][1].stopped_at is not None  # closed again


IN_A_TERMINAL = """
import fcntl, sys, termios
from types import SimpleNamespace

def main():
    fcntl.ioctl(0, termios.TIOCSCTTY, 0)
    sys.path.insert(0, sys.argv.pop(1))
    from kinematic_arm import KinematicArm
    from daq import session
    from drivers import command
    entry = SimpleNamespace(name="kinematic", load=lambda: lambda settings: KinematicArm())
    session.entry_points = lambda group: [entry]
    command.main()

if __name__ == "__main__":
    main()
"""


def test_ctrl_c_in_a_terminal_ends_recording_and_display_in_order(bench):
    keyboard, terminal = pty.openpty()
    arguments = ("record", "robot.yaml", "--duration", "60", "-o", "run.h5")
    support = str(Path(sys.modules["kinematic_arm"].__file__).parent)
    root = Path(session.__file__).parents[1]
    process = subprocess.Popen(
        [sys.executable, "-c", IN_A_TERMINAL, support, *arguments],
        stdin=terminal,
        stdout=terminal,
        stderr=terminal,
        start_new_session=True,
        env={**os.environ, "PYTHONPATH": str(root), "TERM": "xterm", "COLUMNS": "120"},
    )
    os.close(terminal)
    patience = threading.Timer(20.0, process.kill)
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
    assert "of 60.0 s" in text
    assert "largest torque so far 10 % of its limit (shoulder)" in text
    recording = read_recording(bench.folder / "run.h5")
    assert any("stopped: interrupted" in event.message for event in recording.events)
