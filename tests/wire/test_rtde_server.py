"""The unmodified ur_rtde 1.6.5 against simulated controllers; server and client each in their own process."""

from __future__ import annotations

import numpy as np
import pytest
from exact_plant import ExactPlant
from rtde_bench import BareClient, loopback, served, served_exact, ur_rtde

pytestmark = pytest.mark.realtime
GOAL = [0.1, -0.2, 0.3, -0.4, 0.5, -0.6]


def test_receive_agrees_with_the_plant() -> None:
    arm = ExactPlant().measure()
    with served_exact() as host:
        out = ur_rtde(
            """
            receive = Receive(hosts[0])
            out |= dict(q=receive.getActualQ(), qd=receive.getActualQd(), current=receive.getActualCurrent())
            out |= dict(temperature=receive.getJointTemperatures(), moment=receive.getTargetMoment())
            out |= dict(mode=receive.getRobotMode(), safety=receive.getSafetyMode(), joints=receive.getJointMode())
            times = set()
            end = time.time() + 0.5
            while time.time() < end:
                times.add(receive.getTimestamp())
                time.sleep(0.0005)
            out["times"] = sorted(times)
            """,
            host,
        )
    for name, expected in (("q", arm.position), ("current", arm.current), ("temperature", arm.temperature)):
        np.testing.assert_array_equal(out[name], expected)
    np.testing.assert_array_equal(out["moment"], arm.target_torque)
    assert (out["mode"], out["safety"], out["joints"], out["qd"]) == (7, 1, [253] * 6, [0.0] * 6)
    assert len(out["times"]) > 100
    np.testing.assert_allclose(np.array(out["times"]) * 500, np.round(np.array(out["times"]) * 500), atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize(("version", "rate"), [("3.15", 125.0), ("5.22", 500.0), ("5.23", 500.0), ("10.10", 500.0)])
def test_every_version_moves_the_arm(version: str, rate: float) -> None:
    """Receive asks for its default variables, which depend on the version; one unknown and it would not start."""
    with served_exact(version) as host:
        out = ur_rtde(
            f"""
            receive, control = Receive(hosts[0]), Control(hosts[0])
            began = time.time()
            out["done"] = control.moveJ({GOAL}, 2.0, 8.0)
            out["took"] = time.time() - began
            while time.time() < began + 5.0:  # the receiving thread of a busy machine lags behind
                out["q"] = receive.getActualQ()
                if max(abs(q - goal) for q, goal in zip(out["q"], {GOAL})) < 1e-12:
                    break
            stamps = []
            while len(stamps) < 100:
                stamp = receive.getTimestamp()
                if not stamps or stamp != stamps[-1]:
                    stamps.append(stamp)
            out["period"] = min(b - a for a, b in zip(stamps, stamps[1:]))  # this client skips packages
            control.stopScript()
            out["running"] = control.isProgramRunning()
            """,
            host,
        )
    assert out["done"]
    assert not out["running"]
    np.testing.assert_allclose(out["q"], GOAL, atol=1e-12)
    # 1.1 rad at 2 rad/s and 8 rad/s²: 1.1/2 + 2/8.
    assert 0.79 < float(str(out["took"])) < 3.0
    assert out["period"] == pytest.approx(1.0 / rate, rel=1e-6)


@pytest.mark.slow
def test_servoj_follows_a_slow_sine_and_servostop_stops_it() -> None:
    with served_exact() as host:
        out = ur_rtde(
            """
            receive, control = Receive(hosts[0]), Control(hosts[0])
            start = receive.getActualQ()
            wanted, reached = [], []
            for step in range(1000):
                period = control.initPeriod()
                shift = 0.2 * (1 - math.cos(math.pi * step * 0.002))
                control.servoJ([q + shift for q in start], 0.5, 0.5, 0.002, 0.03, 300)
                wanted.append(start[0] + shift)
                reached.append(receive.getActualQ()[0])
                control.waitPeriod(period)
            out |= dict(wanted=wanted, reached=reached, moving=receive.getActualQd(), stopped=control.servoStop())
            time.sleep(0.05)
            out["rest"] = receive.getActualQd()
            """,
            host,
        )
    wanted, reached = np.array(out["wanted"]), np.array(out["reached"])
    # The lag is the lookahead of 30 ms at up to 0.63 rad/s, and what the computers add.
    assert np.max(np.abs(wanted - reached)) < 0.63 * 0.25
    assert np.ptp(reached) == pytest.approx(0.4, abs=0.02)
    assert out["stopped"]
    assert out["rest"] == [0.0] * 6


@pytest.mark.slow
def test_speedj_stopj_and_asynchronous_movej() -> None:
    with served_exact() as host:
        out = ur_rtde(
            f"""
            receive, control = Receive(hosts[0]), Control(hosts[0])
            out["speed"] = control.speedJ([0.2, -0.1, 0, 0, 0, 0], 2.0)
            time.sleep(0.3)
            out["moving"] = receive.getActualQd()
            out["stopped"] = control.speedStop()
            time.sleep(0.02)
            out["rest"] = receive.getActualQd()
            out["move"] = control.moveJ({GOAL}, 0.5, 2.0, True)
            time.sleep(0.3)
            out["progress"] = control.getAsyncOperationProgress()
            out["underway"] = receive.getActualQd()
            control.stopJ(5.0)
            time.sleep(0.02)
            out["progress_after"] = control.getAsyncOperationProgress()
            out["after"], out["q"] = receive.getActualQd(), receive.getActualQ()
            """,
            host,
        )
    np.testing.assert_allclose(out["moving"], [0.2, -0.1, 0, 0, 0, 0], atol=1e-12)
    assert out["speed"]
    assert out["stopped"]
    assert out["move"]
    assert out["rest"] == out["after"] == [0.0] * 6
    assert np.max(np.abs(out["underway"])) == pytest.approx(0.5)
    assert out["progress"] == 0
    assert int(str(out["progress_after"])) < 0
    assert np.max(np.abs(np.array(out["q"]) - GOAL)) > 0.1


def test_a_target_outside_the_limits_stops_protectively() -> None:
    with served_exact() as host:
        out = ur_rtde(
            """
            receive, control = Receive(hosts[0]), Control(hosts[0])
            out["inside"] = control.isJointsWithinSafetyLimits([7, 0, 0, 0, 0, 0])
            before = receive.getActualQ()
            out["done"] = control.moveJ([7, 0, 0, 0, 0, 0], 1.0, 1.0)
            time.sleep(0.02)
            out |= dict(stopped=receive.isProtectiveStopped(), mode=receive.getSafetyMode())
            out["still"] = before == receive.getActualQ()
            """,
            host,
        )
    assert out == {"inside": False, "done": False, "stopped": True, "mode": 3, "still": True}


def test_what_is_not_simulated_fails_and_the_script_can_be_sent_again() -> None:
    with served_exact() as host:
        out = ur_rtde(
            f"""
            control = Control(hosts[0])
            out["linear"] = control.moveL([0.1, 0.2, 0.3, 0, 0, 0], 0.1, 0.1)
            out["running"] = control.isProgramRunning()
            control.reuploadScript()
            time.sleep(0.1)
            out["again"] = control.moveJ({GOAL}, 3.0, 20.0)
            """,
            host,
        )
    assert out == {"linear": False, "running": False, "again": True}


@pytest.mark.slow
def test_two_arms_on_two_addresses_and_outputs() -> None:
    with served_exact() as one, served_exact() as other:
        out = ur_rtde(
            f"""
            receive = [Receive(host) for host in hosts]
            control = Control(hosts[1])
            io = IO(hosts[0])
            control.moveJ({GOAL}, 3.0, 20.0)
            io.setStandardDigitalOut(3, True)
            io.setAnalogOutputVoltage(1, 0.25)
            time.sleep(0.1)
            out["q"] = [client.getActualQ() for client in receive]
            out["bits"] = [client.getActualDigitalOutputBits() for client in receive]
            out["volt"] = receive[0].getStandardAnalogOutput1()
            """,
            one,
            other,
        )
    np.testing.assert_allclose(out["q"], [ExactPlant().position, GOAL], atol=1e-12)
    assert out["bits"] == [8, 0]
    assert out["volt"] == pytest.approx(2.5)


def test_the_command_serves_a_simulated_ur5e_and_obeys_typed_faults() -> None:
    host = loopback()
    command = ("-c", "from drivers.command import main; main()", "sim", "ur5e", "--host", host, "--no-ui")
    with served(*command) as (ready, process), BareClient(host, 30004) as client:
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
