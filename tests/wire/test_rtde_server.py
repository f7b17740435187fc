"""The unmodified ur_rtde 1.6.5 against simulated controllers, in real time; how long anything takes is not asserted."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager

import numpy as np
import pytest
from exact_plant import ExactPlant
from rtde_bench import connected, loopback, served, ur_rtde

from sim_drivers.rtde.server import RtdeServer

pytestmark = [pytest.mark.realtime, pytest.mark.slow]
GOAL = [0.1, -0.2, 0.3, -0.4, 0.5, -0.6]


@contextmanager
def serving(*versions: str) -> Iterator[Sequence[str]]:
    """Addresses of arms that follow their targets exactly, one a version."""
    servers = [RtdeServer(ExactPlant(), loopback(), version) for version in versions]
    with ExitStack() as stack:
        for server in servers:
            stack.enter_context(server)
        yield [server.host for server in servers]
    assert [server.failure for server in servers] == [None] * len(servers)


def test_every_version_is_read_and_moved() -> None:
    """Receive asks for its default variables, which depend on the version; one unknown and it would not start."""
    arm = ExactPlant().measure()
    with serving("3.15", "5.22", "5.23", "10.10") as hosts:
        out = ur_rtde(
            f"""
            out["arms"] = []
            for host in hosts:
                receive = Receive(host)
                arm = dict(q=receive.getActualQ(), qd=receive.getActualQd(), current=receive.getActualCurrent())
                arm |= dict(temperature=receive.getJointTemperatures(), moment=receive.getTargetMoment())
                arm |= dict(mode=receive.getRobotMode(), safety=receive.getSafetyMode(), joints=receive.getJointMode())
                control = Control(host)
                arm["done"] = control.moveJ({GOAL}, 3.0, 40.0)
                wait(lambda: max(abs(q - goal) for q, goal in zip(receive.getActualQ(), {GOAL})) < 1e-12)
                control.stopScript()
                wait(lambda: not control.isProgramRunning())
                out["arms"].append(arm)
            io = IO(hosts[1])
            io.setStandardDigitalOut(3, True)
            io.setAnalogOutputVoltage(1, 0.25)
            receive = Receive(hosts[1])
            wait(lambda: receive.getActualDigitalOutputBits() == 8)
            wait(lambda: abs(receive.getStandardAnalogOutput1() - 2.5) < 1e-6)
            """,
            *hosts,
        )
    assert isinstance(out["arms"], list)
    assert len(out["arms"]) == 4
    for found in out["arms"]:
        for name, expected in (("q", arm.position), ("current", arm.current), ("temperature", arm.temperature)):
            np.testing.assert_array_equal(found[name], expected)
        np.testing.assert_array_equal(found["moment"], arm.target_torque)
        assert (found["mode"], found["safety"], found["joints"], found["qd"]) == (7, 1, [253] * 6, [0.0] * 6)
        assert found["done"]


def test_commands_are_obeyed_refused_and_ended() -> None:
    with serving("5.22") as hosts:
        out = ur_rtde(
            f"""
            receive, control = Receive(hosts[0]), Control(hosts[0])
            at_rest = lambda: receive.getActualQd() == [0.0] * 6

            start = receive.getActualQ()
            for step in range(300):
                period = control.initPeriod()
                shift = 0.2 * (1 - math.cos(math.pi * step / 300))
                out["servo"] = control.servoJ([q + shift for q in start], 0.5, 0.5, 0.002, 0.03, 300)
                control.waitPeriod(period)
            wait(lambda: abs(receive.getActualQ()[0] - start[0] - shift) < 1e-3)
            out["servo_stop"] = control.servoStop()
            wait(at_rest)

            out["speed"] = control.speedJ([0.2, -0.1, 0, 0, 0, 0], 2.0)
            wait(lambda: np.allclose(receive.getActualQd(), [0.2, -0.1, 0, 0, 0, 0], atol=1e-12))
            out["speed_stop"] = control.speedStop()
            wait(at_rest)

            out["move"] = control.moveJ({GOAL}, 0.001, 2.0, True)
            wait(lambda: control.getAsyncOperationProgress() == 0)
            wait(lambda: not at_rest())
            control.stopJ(5.0)
            wait(at_rest)
            wait(lambda: control.getAsyncOperationProgress() < 0)
            out["way_left"] = max(abs(q - goal) for q, goal in zip(receive.getActualQ(), {GOAL}))

            out["linear"] = control.moveL([0.1, 0.2, 0.3, 0, 0, 0], 0.1, 0.1)
            wait(lambda: not control.isProgramRunning())
            control.reuploadScript()
            wait(control.isProgramRunning)
            out["again"] = control.moveJ({GOAL}, 3.0, 20.0)

            out["inside"] = control.isJointsWithinSafetyLimits([7, 0, 0, 0, 0, 0])
            out["outside"] = control.moveJ([7, 0, 0, 0, 0, 0], 1.0, 1.0)
            wait(receive.isProtectiveStopped)
            out["mode"] = receive.getSafetyMode()
            """,
            *hosts,
        )
    assert float(str(out.pop("way_left"))) > 0.1
    done = dict.fromkeys(("servo", "servo_stop", "speed", "speed_stop", "move", "again"), True)
    assert out == done | {"linear": False, "inside": False, "outside": False, "mode": 3}


def test_the_command_serves_a_simulated_ur5e_and_obeys_typed_faults() -> None:
    host = loopback()
    command = ("-c", "from dynid.command import main; main()", "sim", "ur5e", "--host", host, "--no-ui")
    with served(*command) as (ready, process), connected(host) as client:
        assert (ready["ready"], ready["robot"], ready["rate_hz"]) == (True, "ur5e", 500.0)
        client.stream(["timestamp", "actual_q", "joint_temperatures", "safety_mode"])
        first = client.row()
        second = client.row()
        assert second["timestamp"] - first["timestamp"] == pytest.approx(0.002)
        assert process.stdin is not None
        process.stdin.write("heat elbow_joint 20\nnonsense\nprotective-stop\n")
        process.stdin.flush()
        row = client.until(lambda row: row["safety_mode"] == 3)
        assert row["joint_temperatures"][2] - first["joint_temperatures"][2] == pytest.approx(20.0, abs=1.0)
