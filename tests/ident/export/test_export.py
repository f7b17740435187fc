"""Files are read again before they are put in their place, and nothing is overwritten unasked."""

from __future__ import annotations

import re

import pytest
from each import each
from exported_arms import exported_arm

from daq.robot.loader import parse_robot
from drivers.core.errors import ModelError, UsageError
from ident.export import export, mujoco_reading
from ident.export.arm import refuse_unidentified_friction
from ident.export.export import export_mjcf, export_ros2_inertial, export_urdf
from ident.export.reading import ReadBack, Simulation, check_same_torque, simulation_checks

EXPORTERS = (export_urdf, export_mjcf, export_ros2_inertial)


@pytest.fixture(scope="module")
def arm(three_joint):
    return exported_arm(three_joint)


@pytest.mark.parametrize("write", EXPORTERS)
def test_a_file_is_written_once_and_overwritten_when_asked(arm, tmp_path, write):
    pytest.importorskip("mujoco")
    path = tmp_path / "arm"
    outcome = write(arm, path)
    first = path.read_text(encoding="utf-8")
    assert outcome.path == path
    assert outcome.checks == ()
    path.write_text("mine")
    with pytest.raises(UsageError, match=r"exists.*--force"):
        write(arm, path)
    assert path.read_text() == "mine"
    write(arm, path, overwrite=True)
    assert path.read_text(encoding="utf-8") == first
    assert [entry.name for entry in tmp_path.iterdir()] == ["arm"]


def test_names_that_xml_and_yaml_have_to_escape_come_through(three_joint, tmp_path):
    text = three_joint.text
    for plain, odd in (("j1", '"a <b> & c--d"'), ("j2", '"on: [1, 2]"'), ("j3", '"Gelenk-ß"')):
        text = re.sub(rf"\b{plain}\b", odd, text)
    arm = exported_arm(parse_robot(text, where="odd", folder=None))
    for write in EXPORTERS:
        outcome = write(arm, tmp_path / write.__name__)
        assert [check.severity for check in outcome.checks if check.severity == "serious"] == []


def test_what_reads_back_as_another_model_is_not_written(arm, tmp_path, monkeypatch):
    monkeypatch.setattr(export, "new_urdf", lambda arm: new_urdf(arm).replace('<mass value="', '<mass value="1'))
    from ident.export.urdf import new_urdf

    with pytest.raises(ModelError, match=r"Pinocchio .* reads a different model.*was not written"):
        export_urdf(arm, tmp_path / "arm.urdf")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("write", EXPORTERS)
def test_targets_that_cannot_be_written_are_refused(arm, tmp_path, write):
    with pytest.raises(UsageError, match="is a folder"):
        write(arm, tmp_path, overwrite=True)
    with pytest.raises(UsageError, match="no such folder"):
        write(arm, tmp_path / "none" / "arm.urdf", overwrite=True)


def test_without_mujoco_a_check_says_so(arm, tmp_path, monkeypatch):
    monkeypatch.setattr(mujoco_reading, "mujoco_installed", lambda: False)
    outcome = export_mjcf(arm, tmp_path / "arm.xml")
    assert [check.name for check in outcome.checks] == ["export-not-read"]
    assert outcome.checks[0].purposes == ("simulation",)
    assert [reading.reader.split()[0] for reading in export_urdf(arm, tmp_path / "arm.urdf").readings] == ["Pinocchio"]


@each(
    ("simulation", "name"),
    [
        (Simulation("unpowered", finite=False), "export-diverges"),
        (Simulation("unpowered", finite=True, energy_gain=0.06), "export-gains-energy"),
        (Simulation("tracking", finite=True, tracking_error=0.6), "export-loses-motion"),
        (Simulation("unpowered", finite=True, energy_gain=0.04), None),
        (Simulation("tracking", finite=True, tracking_error=0.4), None),
    ],
)
def test_what_a_simulation_shows_is_a_check(simulation, name):
    reading = ReadBack("MuJoCo", 1e-15, 10, (simulation,))
    assert [check.name for check in simulation_checks(reading)] == ([] if name is None else [name])
    assert all(check.severity == "serious" for check in simulation_checks(reading))


@each("error", [2e-6, float("nan"), float("inf")])
def test_other_torques_are_refused(error):
    with pytest.raises(ModelError, match="reads a different model"):
        check_same_torque(ReadBack("Pinocchio", error, 10), "arm.urdf")


def test_friction_that_was_not_identified_is_named():
    refuse_unidentified_friction([], "arm")
    with pytest.raises(ModelError, match="did not identify Fs2 of j2"):
        refuse_unidentified_friction(["Fs2 of j2"], "arm")
