"""The examples run as they stand, and the documents do not drift from the code."""

from __future__ import annotations

import functools
import importlib.util
import re
from pathlib import Path
from types import ModuleType

import pytest

pytestmark = pytest.mark.usefixtures("not_simulated", "stated_friction", "mistakes_not_sought")

REPOSITORY = Path(__file__).resolve().parents[1]


def script(path: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(Path(path).stem, REPOSITORY / path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.usefixtures("estimates_alone")
def test_identify_from_arrays(capsys, tmp_path):
    model = script("examples/identify_from_arrays.py").main(duration=12.0, folder=str(tmp_path / "model"))
    assert model.result.validation.relative_error < 0.1
    assert "which load_model hands out, differs from measured torque by" in capsys.readouterr().out


@pytest.mark.usefixtures("estimates_alone")
def test_the_notebook_runs_and_holds_no_outputs(capsys):
    import json

    cells = json.loads((REPOSITORY / "examples" / "quickstart.ipynb").read_text(encoding="utf-8"))["cells"]
    codes = [cell for cell in cells if cell["cell_type"] == "code"]
    assert not any(cell["outputs"] or cell["execution_count"] for cell in codes)
    names: dict[str, object] = {}
    for cell in codes:
        exec(compile("".join(cell["source"]), cell["id"], "exec"), names)  # our own text, as a user would run it
    assert "differs from measured torque by" in capsys.readouterr().out
    error = names["measured"] - names["predicted"]
    assert (error**2).mean() < 0.1 * (names["measured"] ** 2).mean()


def test_coverage_runs(capsys):
    script("studies/coverage/coverage.py").main(robots=("up6",), seeds=1, methods=("wls",), plays=("periodic",))
    assert capsys.readouterr().out.count("\n| `wls`, periodic | ") == 2


PAGES = sorted([*REPOSITORY.glob("*.md"), *REPOSITORY.glob("docs/**/*.md"), *REPOSITORY.glob("studies/*.md")])


@functools.cache
def anchors(page: Path) -> set[str]:
    """Headings of a page as a link names them."""
    headings = re.findall(r"^#+ (.+)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_links_lead_somewhere():
    lost = []
    for page in PAGES:
        for target, anchor in re.findall(r"\]\(([^)#\s]*)(?:#([^)]*))?\)", page.read_text(encoding="utf-8")):
            linked = (page.parent / target) if target else page
            if target.startswith("http") or (linked.exists() and (not anchor or anchor in anchors(linked))):
                continue
            lost.append(f"{page.relative_to(REPOSITORY)}: {target}#{anchor}")
    assert lost == []


def test_files_that_are_named_exist():
    packages = "drivers|daq|ident|sim_drivers|dynid|tests|studies|benchmarks|examples|docs"
    missing = []
    for page in PAGES:
        for path in re.findall(rf"`((?:{packages})/[\w./-]*)", page.read_text(encoding="utf-8")):
            if path != "tests/soak/found/" and not (REPOSITORY / path).exists():  # written by `make soak`
                missing.append(f"{page.relative_to(REPOSITORY)}: {path}")
    assert missing == []


def test_what_the_site_names_exists():
    import dynid

    listed = re.findall(r": ([\w/-]+\.md)$", (REPOSITORY / "mkdocs.yml").read_text(encoding="utf-8"), re.MULTILINE)
    pages = {str(page.relative_to(REPOSITORY / "docs")) for page in REPOSITORY.glob("docs/**/*.md")}
    assert len(set(listed)) == len(listed)
    assert set(listed) <= pages
    api = (REPOSITORY / "docs" / "api.md").read_text(encoding="utf-8")
    named = set(re.findall(r"^::: dynid\.(\w+)$", api, re.MULTILINE))
    assert named <= set(dir(dynid))
    assert "<!-- every other public name -->" in api or named == set(dir(dynid))


def test_the_robot_file_of_the_docs_is_valid():
    from daq.robot.loader import parse_robot
    from ident.model.base_parameters import base_parameters
    from ident.model.dynamic_model import build_model

    text = (REPOSITORY / "docs" / "robot-file.md").read_text(encoding="utf-8")
    block = re.search(r"```yaml\n(.*?)```", text, re.DOTALL)
    assert block is not None
    robot = parse_robot(block[1], where="docs", folder=None)
    assert base_parameters(build_model(robot)).count > 0


OF_OTHER_PROGRAMS = {
    "--bin",
    "--cases",
    "--device",
    "--network",
    "--no-compile",
    "--no-deps",
    "--rm",
    "--strict",
    "--write",
}
"""Options of pip, Docker and of studies."""


def test_options_named_in_the_docs_exist():
    from typer.main import get_command

    from dynid.command import build_app

    known: set[str] = {"--help", "--json", "--version"}
    stack = [get_command(build_app())]
    while stack:
        command = stack.pop()
        stack.extend(getattr(command, "commands", {}).values())
        for parameter in command.params:
            known.update([*parameter.opts, *parameter.secondary_opts])
    for page in PAGES:
        for option in re.findall(r"--[a-z][a-z0-9-]+", page.read_text(encoding="utf-8")):
            assert option in known | OF_OTHER_PROGRAMS, f"{page.name}: {option}"


def test_the_trajectory_of_the_docs_is_valid():
    from daq.motion.trajectory_file import parse_trajectory
    from daq.robot.loader import load_robot

    text = (REPOSITORY / "docs" / "trajectories.md").read_text(encoding="utf-8")
    block = re.search(r"```yaml\n(.*?)```", text, re.DOTALL)
    assert block is not None
    robot = load_robot("ur5e").robot
    played = parse_trajectory(block[1], robot, where="docs", folder=None)
    assert played.motion.duration == pytest.approx(28.0)
