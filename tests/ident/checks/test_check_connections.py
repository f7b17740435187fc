"""`dynid check`: bus budgets, keys of connections, and what `--connect` finds at the other end."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import ClassVar

import pytest
from each import each
from kinematic_arm import KinematicArm

from daq.robot.loader import load_robot, parse_robot
from daq.session import session
from drivers import declaration
from drivers.base import Notice
from drivers.canopen402.declaration import DECLARATION as DRIVES
from drivers.core.errors import ConnectionFailedError, RobotFileError, UsageError
from drivers.declaration import DriverDeclaration
from drivers.rtde.declaration import DECLARATION as CONTROLLER
from drivers.streams import ChannelLayout, StreamLayout
from ident.checks.connection_check import FIRST_SAMPLE_LIMIT, LISTEN, check_connections
from ident.checks.robot_check import check_robot

CANOPEN = """
connections:
  bus:
    driver: canopen402
    interface: virtual
    channel: x
    bitrate: {bitrate}
    sync_rate: {rate}
    nodes: {{j1: {{id: 1}}, j2: {{id: 2}}, j3: {{id: {third}}}}}
"""
BENCH = """
connections:
  bench: {driver: bench, rate: 200, with: [oven]}
  oven: {driver: oven}
  lost: {driver: bench, with: [nowhere]}
  twice: {driver: bench, with: [oven, oven]}
  itself: {driver: bench, with: [itself]}
  wrong: {driver: bench, with: oven}
"""


def with_connections(three_joint, text: str):
    return parse_robot(three_joint.text + text, where="three_joint", folder=None)


@dataclass(frozen=True)
class Who:
    joint: str
    firmware: str
    rated_current: float
    rated_torque: float


class Bench(KinematicArm):
    """Three joints, a drive whose rating contradicts the file, a position beyond its limit, a rate that is not kept."""

    made: ClassVar[list[Bench]] = []

    def __init__(self, settings):
        super().__init__(clock=settings.clock)
        assert "with" not in settings.connection
        self.settings = settings
        self.closed = False
        Bench.made.append(self)

    def identify(self):
        return (Who("j1", "1.0", 5.0, 50.0), Who("j3", "1.0", 5.0, 50.0))

    def streams(self):
        (layout,) = super().streams()
        channels = tuple(ChannelLayout(c.quantity, ("j1", "j2"), c.unit) for c in layout.channels)
        return (StreamLayout("joints", channels, 300.0),)

    def read(self, timeout):
        blocks = super().read(timeout)
        for block in blocks:
            block.values["position"][:, 1] = 3.5
        return blocks

    def notices(self):
        return (Notice(float("nan"), "warning", "a little dusty"),)

    def close(self):
        super().close()
        self.closed = True


class Oven(Bench):
    def open(self):
        if self.settings.connection.get("broken"):
            raise ConnectionFailedError("nobody answers")

    def identify(self):
        return ()


@pytest.fixture
def drivers(monkeypatch):
    """Drivers of this test beside the real ones, whatever was installed."""
    Bench.made.clear()
    install(
        monkeypatch, canopen402=DRIVES, rtde=CONTROLLER, bench=DriverDeclaration(Bench), oven=DriverDeclaration(Oven)
    )


def install(monkeypatch, **declarations):
    entries = [SimpleNamespace(name=name, load=lambda found=found: found) for name, found in declarations.items()]
    monkeypatch.setattr(declaration, "entry_points", lambda group: entries)


def test_a_bus_with_room_is_no_warning_a_tight_one_is_and_a_full_one_is_refused(three_joint, drivers):
    roomy = with_connections(three_joint, CANOPEN.format(bitrate=1000000, rate=400, third=3))
    assert check_robot(roomy).warnings == ()
    (budget,) = check_robot(roomy).budgets.values()
    assert budget.cycle_bits == 55 + 3 * (125 + 135 + 125)
    tight = with_connections(three_joint, CANOPEN.format(bitrate=1000000, rate=750, third=3))
    (warning,) = check_robot(tight).warnings
    assert "connection 'bus' fills its bus to 91.0 % at worst; at 659 Hz it would be 80 %" in warning
    full = with_connections(three_joint, CANOPEN.format(bitrate=500000, rate=750, third=3))
    (problem,) = check_robot(full).problems
    assert isinstance(problem, RobotFileError)
    assert re.search(r"750 Hz does not fit on a bus of 500000 bit/s: 182 % .*at most 411 Hz", str(problem))


def test_wrong_keys_are_refused_with_the_connections_name(three_joint, drivers):
    robot_file = with_connections(three_joint, CANOPEN.format(bitrate=1000000, rate=400, third=300))
    (problem,) = check_robot(robot_file).problems
    assert isinstance(problem, UsageError)
    assert re.search(r"connections\.bus: .*nodes\.j3\.id", str(problem))


def test_the_command_prints_the_budget(run_dynid):
    status, out, _ = run_dynid("check", "ur5e", "--verbose")
    assert status == 0
    assert "connection canopen: bus load 30.8 % (1000 kbit/s) at 125 Hz" in out
    assert "6 × TPDO2 (8 bytes)" in out
    status, out, _ = run_dynid("check", "ur5e", "--json")
    budget = json.loads(out)["budgets"]["canopen"]
    assert budget["load_percent"] == pytest.approx(30.8275)
    assert budget["highest_rate_at_80_percent_hz"] == pytest.approx(333, abs=1)


def test_connecting_tells_who_answers_and_what_contradicts_the_file(three_joint, drivers, clock):
    robot_file = with_connections(three_joint, BENCH)
    found = check_connections(robot_file, None, clock=clock)
    assert [one.name for one in found] == ["bench", "oven"]  # and what it is recorded with
    bench = found[0]
    assert [identity["joint"] for identity in bench.identities] == ["j1", "j3"]
    assert bench.streams[0].first["position"] == {"j1": pytest.approx(0.1), "j2": 3.5}
    assert bench.streams[0].rate_hz == pytest.approx(200.0, rel=1e-9)
    assert "warning: a little dusty" in bench.notices
    told = "\n".join(bench.warnings)
    assert "stream joints: arrives at 200 Hz instead of the nominal 300 Hz" in told
    assert "position of j2: 3.5 rad passes 3 rad" in told
    assert "drive gain of j3: 4 N·m/A in 'drives', but the rated torque over the rated current is 10 N·m/A" in told
    assert "gain of j1" not in told
    for driver in Bench.made:  # after a second from the first sample on
        assert driver.samples[-1].host_time[-1] - driver.begun == pytest.approx(LISTEN + 1.0 / 200.0)
    assert all(driver.stopped_at is not None and driver.closed and not driver.commands for driver in Bench.made)


@each(
    ("wire", "said"),
    [
        ("lost", "no connection is called 'nowhere'"),
        ("twice", "names a connection twice"),
        ("itself", "names a connection twice, or itself"),
        ("wrong", "should be a list of connections"),
        ("other", "no connection is called 'other'"),
    ],
)
def test_what_a_connection_is_recorded_with_must_exist(three_joint, drivers, wire, said):
    with pytest.raises(UsageError, match=said):
        check_connections(with_connections(three_joint, BENCH), wire)
    with pytest.raises(UsageError, match=said):
        session.load_driver(with_connections(three_joint, BENCH).robot, wire)


def test_a_session_takes_all_that_are_named(three_joint, drivers):
    driver = session.load_driver(with_connections(three_joint, BENCH).robot)
    driver.open()
    assert [layout.name for layout in driver.streams()] == ["joints", "oven"]
    driver.close()


def test_nobody_there_is_an_error_and_everything_is_closed(three_joint, drivers):
    text = "\nconnections:\n  oven: {driver: oven, broken: true}\n"
    with pytest.raises(ConnectionFailedError, match="nobody answers"):
        check_connections(with_connections(three_joint, text), None)
    assert Bench.made[-1].closed


def test_a_source_that_says_nothing_is_an_error(three_joint, drivers, monkeypatch, clock):
    begun = clock.now()
    monkeypatch.setattr(Bench, "read", lambda self, timeout: clock.sleep(timeout) or ())
    with pytest.raises(ConnectionFailedError, match=r"connection bench: it is open, but no sample arrived within 5 s"):
        check_connections(with_connections(three_joint, BENCH), None, clock=clock)
    assert clock.now() - begun == pytest.approx(FIRST_SAMPLE_LIMIT, abs=0.05)


def test_drives_are_not_prepared_for_a_motion(monkeypatch):
    seen = []

    def make(settings):
        seen.append(dict(settings.connection))
        raise ConnectionFailedError("far enough")

    install(monkeypatch, canopen402=replace(DRIVES, driver=make))
    for asked in (False, True):
        with pytest.raises(ConnectionFailedError):
            check_connections(load_robot("ur5e"), "canopen", reset_faults=asked)
        assert (seen[-1]["mode"], seen[-1]["sync_rate"]) == ("none", 125)
        assert seen[-1].get("reset_faults", False) is asked


def test_wire_without_connect_is_refused(run_dynid):
    for options in (("--wire", "rtde"), ("--reset-faults",)):
        status, _, err = run_dynid("check", "ur5e", *options)
        assert status == 2
        assert "add --connect" in err


def test_the_command_shows_what_answered(run_dynid, monkeypatch, tmp_path, three_joint, drivers, clock):
    monkeypatch.setattr("drivers.core.clock.SYSTEM_CLOCK", clock)
    (tmp_path / "arm.yaml").write_text(three_joint.text + BENCH.split("  lost")[0])
    status, out, _ = run_dynid("check", str(tmp_path / "arm.yaml"), "--connect", "--verbose")
    assert status == 0
    assert "connection bench (bench) answers" in out
    assert "joint j1, firmware 1.0, rated current 5, rated torque 50" in out
    assert "position [rad]" in out
    status, out, _ = run_dynid("check", str(tmp_path / "arm.yaml"), "--connect", "--json")
    content = json.loads(out)
    assert content["connections"][0]["streams"][0]["first"]["position"]["j2"] == 3.5
    assert content["connections"][0]["streams"][0]["rate_hz"] == pytest.approx(200.0)
