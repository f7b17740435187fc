"""The page of a designed excitation: complete, self-contained, safe."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from html_page import Page

from daq.motion.trajectories import RestToRest
from daq.robot.loader import RobotFile, load_robot, parse_robot
from drivers.core.errors import UsageError
from ident.excite.constraints.collision_geometry import arm_geometry
from ident.excite.forecast import excitation_figures
from ident.excite.page.page import FRAMES, arm_figure, capsule_mesh, excitation_page
from ident.excite.page.plots import shown_part
from ident.excite.prior import PriorKnowledge, find_prior
from ident.model.dynamic_model import build_model
from ident.model.dynamics.pinocchio_model import pinocchio_model
from ident.tasks.excitation import ExcitationTrajectory
from sim_drivers.synthetic.measurement import random_fourier_motion

NOTES = [("Kind", "fourier"), ("Criterion", "condition: 4.2")]
WORKSPACE = "workspace:\n  tool: [0.4, 0, 0.1]\n  radius: [0.05, 2]\n  height: [-1, 2]\n"
OBSTACLE = "  keep_out: [{name: crate, box: {lower: [2, 2, 0], upper: [3, 3, 1]}, clearance: 0.07}]\n"


def motion_of(robot_file: RobotFile, periods: int = 2) -> RestToRest:
    return RestToRest(random_fourier_motion(build_model(robot_file), 8.0, seed=1), periods, 1.0)


def text_of(robot_file: RobotFile, prior: PriorKnowledge | None = None, periods: int = 2) -> str:
    prior = find_prior(robot_file) if prior is None else prior
    motion = motion_of(robot_file, periods)
    return excitation_page(robot_file, motion, prior, excitation_figures(robot_file, motion, prior), NOTES)


@pytest.fixture(scope="module")
def text(three_joint) -> str:
    return text_of(parse_robot(three_joint.text + WORKSPACE + OBSTACLE, where="", folder=None))


@pytest.fixture(scope="module")
def usual(text) -> Page:
    return Page(text)


def test_every_parameter_and_joint_is_in_a_table(usual, three_joint):
    prior = find_prior(three_joint)
    figures = excitation_figures(three_joint, motion_of(three_joint), prior)
    for parameter in figures.forecast.parameters:
        assert parameter.name in usual.words
        assert parameter.expression in usual.words
    for joint in figures.joints:
        assert joint.joint in usual.words
    for _, words in NOTES:
        assert words in usual.words
    assert figures.prior in usual.words
    assert figures.worst_limit in usual.words
    sorted_by = [float(a["data-sort"]) for _, a in usual.elements if re.fullmatch(r"-?\d.*", a.get("data-sort") or "")]
    for parameter in figures.forecast.parameters:
        assert parameter.std in sorted_by


def test_links_lead_to_sections(usual):
    links = [attributes["href"] for tag, attributes in usual.elements if tag == "a"]
    assert links == ["#figures", "#arm", "#limits", "#joints", "#tool", "#clearances", "#forecast", "#design"]
    assert {str(link)[1:] for link in links} <= set(usual.ids())
    assert len(usual.ids()) == len(set(usual.ids()))


def test_nothing_is_fetched(usual, text):
    for tag, attributes in usual.elements:
        assert tag not in ("link", "iframe", "object", "embed", "img", "base", "form")
        assert "src" not in attributes
        assert (attributes.get("href") or "#").startswith("#")
    policies = [attributes["content"] for _, attributes in usual.elements if attributes.get("http-equiv")]
    assert str(policies[0]).startswith("default-src 'none'")
    assert "http" not in str(policies[0])
    script = text[text.rindex("<script>") :]
    assert not re.search(r"https?:|@import|url\(", re.sub(r"//[^\n]*", "", script))


def test_every_figure_has_its_place_and_axes(usual):
    assert set(usual.figures) == {"arm-plot", "joints-plot", "tool-plot", "clearance-plot"}
    assert set(usual.figures) <= set(usual.ids())
    for name in ("joints-plot", "tool-plot", "clearance-plot"):
        figure = usual.figures[name]
        axes = {key.replace("axis", "") for key in figure["layout"] if re.fullmatch(r"[xy]axis\d*", key)}
        assert {trace.get(axis, axis[0]) for trace in figure["data"] for axis in ("xaxis", "yaxis")} <= axes


def test_limits_are_drawn(usual, three_joint):
    lines = {(shape["yref"], shape["y0"]) for shape in usual.figures["joints-plot"]["layout"]["shapes"]}
    for row, limits in enumerate(three_joint.robot.joints):
        position = "y" if row == 0 else f"y{3 * row + 1}"
        assert {(position, limits.position[0]), (position, limits.position[1])} <= lines
        assert (f"y{3 * row + 2}", limits.velocity) in lines
        assert (f"y{3 * row + 3}", -limits.torque) in lines
    heights = {shape["y0"] for shape in usual.figures["tool-plot"]["layout"]["shapes"]}
    assert heights == {0.05, 2.0, -1.0}


def test_frames_and_slider_belong_together(usual):
    frames = usual.frames["arm-plot"]
    assert 2 <= len(frames) <= 100
    slider = usual.figures["arm-plot"]["layout"]["sliders"][0]
    assert [step["args"][0] for step in slider["steps"]] == [[frame["name"]] for frame in frames]
    buttons = usual.figures["arm-plot"]["layout"]["updatemenus"][0]["buttons"]
    assert [button["label"] for button in buttons] == ["Play", "Pause"]
    for frame in frames:
        assert frame["traces"] == [1, 2]
        assert len(frame["data"][0]["x"]) == 5  # base, three joints, tool


def test_surroundings_and_the_thickness_of_links_are_drawn(usual):
    names = [trace["name"] for trace in usual.figures["arm-plot"]["data"]]
    assert names[2:] == ["links, as thick as they are checked", "crate"]
    skin = usual.figures["arm-plot"]["data"][2]
    assert max(max(skin[name]) for name in "ijk") == len(skin["x"]) - 1
    for frame in usual.frames["arm-plot"]:
        assert len(frame["data"][1]["x"]) == len(skin["x"])


def test_clearances_are_drawn_with_what_is_kept(usual):
    figure = usual.figures["clearance-plot"]
    names = [trace["name"] for trace in figure["data"]]
    assert "crate" in names
    assert figure["layout"]["shapes"][names.index("crate")]["y0"] == 0.07


def test_capsules_are_drawn_just_inside_their_surface():
    geometry = arm_geometry(load_robot("ur5e"), build_model(load_robot("ur5e")))
    mesh = capsule_mesh(geometry)
    assert mesh.triangles.max() == len(mesh.vertices) - 1
    per_capsule = len(mesh.vertices) // len(geometry.capsules)
    for index, capsule in enumerate(geometry.capsules):
        mine = mesh.vertices[index * per_capsule : (index + 1) * per_capsule]
        way = capsule.end - capsule.start
        share = np.clip((mine - capsule.start) @ way / max(float(way @ way), 1e-12), 0.0, 1.0)
        distance = np.linalg.norm(mine - capsule.start - share[:, None] * way, axis=1)
        np.testing.assert_allclose(distance, capsule.radius, atol=1e-9)


def test_the_arm_stands_where_pinocchio_puts_it(three_joint):
    import pinocchio as pin

    robot_file = parse_robot(three_joint.text + WORKSPACE, where="", folder=None)
    motion = motion_of(robot_file)
    figure = arm_figure(robot_file, motion, shown_part(robot_file, motion, find_prior(robot_file)))
    arm = pinocchio_model(build_model(robot_file))
    data = arm.createData()
    moments = np.linspace(0.0, 9.0, FRAMES)  # the ramp and one period
    for number in (0, 40, FRAMES - 1):
        pin.forwardKinematics(arm, data, motion.evaluate(moments[number : number + 1])[0][:, 0])
        line = figure.frames[number]["data"][0]
        points = np.array([line[name] for name in "xyz"]).T
        expected = [
            np.zeros(3),
            *(data.oMi[joint].translation for joint in (1, 2, 3)),
            data.oMi[3].act(np.array([0.4, 0, 0.1])),
        ]
        assert points == pytest.approx(np.array(expected), abs=1e-4)


def test_one_repetition_of_many_is_shown_and_said(three_joint):
    motion = motion_of(three_joint, 7)
    prior = find_prior(three_joint)
    shown = shown_part(three_joint, motion, prior)
    assert (shown.path.time[-1], shown.repetitions) == (9.0, 7)
    assert "the first of its 7 repetitions" in Page(text_of(three_joint, periods=7)).words
    once = shown_part(three_joint, motion_of(three_joint, 1), prior)
    assert (once.path.time[-1], once.repetitions) == (10.0, 1)


def test_without_a_prior_there_are_no_torques(three_joint):
    page = Page(text_of(three_joint, replace(find_prior(three_joint), parameters=None)))
    assert not [trace for trace in page.figures["joints-plot"]["data"] if "torque" in trace.get("name", "")]
    assert "without prior parameters" in page.words


def test_what_is_not_excited_is_said(three_joint):
    motion = motion_of(three_joint)
    inner = motion.motion
    sine, cosine = inner.sine.copy(), inner.cosine.copy()
    sine[1] = cosine[1] = 0.0
    motion = replace(motion, motion=replace(inner, sine=sine, cosine=cosine))
    prior = find_prior(three_joint)
    page = Page(excitation_page(three_joint, motion, prior, excitation_figures(three_joint, motion, prior), NOTES))
    assert re.search(r"does not excite [^.]*Fs2", page.words)


def test_names_stay_text(three_joint):
    hostile = "</script><script>alert(1)</script>&<b>x"
    text = three_joint.text.replace("name: three_joint", f"name: '{hostile}'").replace("j2", f"'{hostile}2'")
    page = text_of(parse_robot(text, where="", folder=None))
    assert "<script>alert(1)" not in page
    assert "<b>x" not in page
    assert hostile in Page(page).words


def test_a_folder_that_does_not_exist_is_told(three_joint, tmp_path):
    trajectory = ExcitationTrajectory(three_joint, "", motion_of(three_joint), find_prior(three_joint))
    with pytest.raises(UsageError, match="folder"):
        trajectory.page(tmp_path / "none" / "page.html")
    trajectory.page(tmp_path / "page.html")
    assert (tmp_path / "page.html").stat().st_size > 1e6
