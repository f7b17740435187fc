"""Every page that dynid writes, opened in headless Chromium at the width of a window and of a phone."""

from __future__ import annotations

import csv
import functools
import re
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from arm_histories import worn_arm
from chromium import BrowserPage, chromium, chromium_path
from friction_experiment_arm import experiment
from loaded_arm import LOAD
from loaded_arm import runs as loaded_runs
from page_layout import COLLIDING_TEXTS, OVERFLOW

from daq.motion.trajectories import RestToRest
from daq.output_files import REPORT_FILE
from daq.recording.recording import Recording
from daq.robot.loader import load_robot
from drivers.core.arrays import FloatArray
from ident.checks.page.page import render_page as render_info_page
from ident.checks.recording_check import recording_info
from ident.excite.forecast import excitation_figures
from ident.excite.page import page as design_page
from ident.excite.prior import find_prior
from ident.history.database import add_entries
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import build_model
from ident.model.true_parameters import truth_vector
from ident.report import ReportData, TruthTable, render_report
from ident.report import monitor_page as watched_page
from ident.result.tables import table_of_rows
from ident.tasks.history import History
from ident.tasks.identification import IdentificationResult, identify
from ident.tasks.loads import drive_gains, payload
from ident.tasks.prediction import predict
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording

pytestmark = [pytest.mark.realtime, pytest.mark.slow]

ARM = "ur5e"
WINDOW, PHONE = 1400, 400
MOST_PRINTED_PAGES = 4


def recorded(seed: int, samples: slice | FloatArray = slice(None), rate: float = 62.5) -> Recording:
    """A simulated recording with temperatures."""
    robot_file = load_robot(ARM)
    motion = random_fourier_motion(build_model(robot_file), 8.0, seed=seed, candidates=2)
    stream = simulate_recording(robot_file, motion, 12.0, seed=seed, rate=rate).streams["joints"]
    time = stream.time[samples]
    return Recording.from_arrays(
        robot_file,
        time=time,
        position=stream.channels["position"].values[samples],
        current=stream.channels["current"].values[samples],
        temperature=30.0 + 0.1 * time[:, None] + np.arange(6),
    )


@functools.cache
def identified() -> IdentificationResult:
    """What the pages of an identification and of a prediction are of."""
    return identify(recorded(1), validation=recorded(2))


def identification_page(folder: Path) -> Path:
    robot_file = load_robot(ARM)
    base = base_parameters(build_model(robot_file))
    found = identified()
    truth = TruthTable(base.names, base.projection @ truth_vector(robot_file))
    data = ReportData(found.result, found.fit_series, found.validation_series, truth, found.recorded)
    path = folder / "report.html"
    path.write_text(render_report(data), encoding="utf-8")
    return path


def excitation_page(folder: Path) -> Path:
    robot_file = load_robot(ARM)
    motion = RestToRest(random_fourier_motion(build_model(robot_file), 8.0, seed=1, candidates=2), 2, 1.0)
    prior = find_prior(robot_file)
    path = folder / "excitation.html"
    figures = excitation_figures(robot_file, motion, prior)
    path.write_text(design_page.excitation_page(robot_file, motion, prior, figures, [("Kind", "fourier")]))
    return path


def recording_page(folder: Path) -> Path:
    kept = np.delete(np.arange(1500), [*range(300, 420), 900, 901])
    recording = recorded(3, kept, rate=125.0)
    path = folder / "info.html"
    path.write_text(render_info_page(recording_info(recording, recording.robot()), "run.h5"), encoding="utf-8")
    return path


def prediction_page(folder: Path) -> Path:
    path = folder / "prediction.html"
    predict(identified(), recorded(3)).page(path)
    return path


def payload_page(folder: Path) -> Path:
    free, loaded = loaded_runs(0, hidden=True)
    payload(free, loaded, mass=LOAD.mass).save(folder)
    return folder / REPORT_FILE


def gains_page(folder: Path) -> Path:
    free, loaded = loaded_runs(0, hidden=True)
    drive_gains(free, loaded, mass=LOAD.mass).save(folder)
    return folder / REPORT_FILE


def friction_page(folder: Path) -> Path:
    experiment().save(folder)
    return folder / REPORT_FILE


def monitor_page(folder: Path) -> Path:
    time, joints = 0.01 * np.arange(2000), np.arange(6.0)
    external, threshold = np.sin(time[:, None] + joints), np.full((2000, 6), 1.5)
    table = table_of_rows("Contacts", [("time", "s"), ("joint", "")], [(1.0, "elbow_joint"), (2.0, "wrist_1_joint")])
    page = folder / "contacts.html"
    series = (time, external, threshold)
    page.write_text(watched_page.monitor_page(load_robot(ARM).robot, "run.h5", [table], ["direct observer"], series))
    return page


def history_page(folder: Path) -> Path:
    path, page = folder / "arm.db", folder / "history.html"
    add_entries(path, worn_arm(1, 60, dict.fromkeys(("Fs1", "Fs2", "Fs3"), 0.2), step=0.3))
    History(path).trend().page(page)
    return page


PAGES: dict[str, Callable[[Path], Path]] = {
    "identification": identification_page,
    "excitation": excitation_page,
    "recording": recording_page,
    "prediction": prediction_page,
    "payload": payload_page,
    "gains": gains_page,
    "friction": friction_page,
    "history": history_page,
    "monitor": monitor_page,
}
"""What writes each page into a folder; a new page is one line here."""


@pytest.fixture(scope="module")
def page() -> Iterator[BrowserPage]:
    """One page of one browser for all tests."""
    program = chromium_path()
    if program is None:
        pytest.skip("no Chromium on this machine: apt-get install chromium fonts-dejavu-core")
    with chromium(program) as browser:
        yield browser.new_page()


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """The file of a page, written once."""
    files: dict[str, Path] = {}

    def file(name: str) -> Path:
        if name not in files:
            files[name] = PAGES[name](tmp_path_factory.mktemp(name))
        return files[name]

    return file


@pytest.mark.parametrize("name", PAGES)
def test_page(page: BrowserPage, written: Callable[[str], Path], tmp_path: Path, name: str) -> None:
    page.open(written(name), PHONE)
    check_folding(page)
    drawn = page.evaluate("document.querySelectorAll('.plot .main-svg').length")
    assert drawn >= page.evaluate("document.querySelectorAll('.plot').length") > 0
    check_layout(page)
    check_zoom(page, PHONE)
    # Figures are rearranged when the window becomes wide.
    page.resize(WINDOW)
    page.evaluate(SETTLED)
    check_layout(page)
    check_zoom(page, WINDOW)
    check_sorting(page)
    check_downloads(page, tmp_path)
    assert page.problems == []
    if name == "identification":
        check_parameters_print(page, written(name), tmp_path / "printed.html")


def check_folding(page: BrowserPage) -> None:
    """What is folded is drawn when a link, or the button, unfolds it."""
    anchor = page.evaluate("""(() => {
      const folded = Array.from(document.querySelectorAll("details.part")).find((one) => one.querySelector(".plot"));
      return folded && document.querySelector(`nav a[href="#${folded.id}"]`) ? folded.id : "";
    })()""")
    if anchor:
        assert page.evaluate(f"document.querySelectorAll('#{anchor} .main-svg').length") == 0
        page.evaluate(f"document.querySelector('nav a[href=\"#{anchor}\"]').click()")
        page.evaluate(UNFOLDED)
        assert page.evaluate(f"document.querySelectorAll('#{anchor} .main-svg').length") > 0
    page.evaluate("document.querySelectorAll('details').forEach((one) => { one.open = true; })")
    page.evaluate(UNFOLDED)


# A toggle is told a moment after it.
UNFOLDED = """(async () => {
  for (let turn = 0; turn < 3; turn++) await new Promise(requestAnimationFrame);
  while (document.documentElement.dataset.drawn === undefined) await new Promise(requestAnimationFrame);
})()"""


def check_layout(page: BrowserPage) -> None:
    assert page.evaluate(OVERFLOW) == []
    assert page.evaluate(COLLIDING_TEXTS) == []


# Plotly follows the window's width a while after the event.
SETTLED = """(async () => {
  for (const plot of document.querySelectorAll(".plot")) {
    const late = () => plot.offsetParent && Math.abs(plot._fullLayout.width - plot.clientWidth) > 1;
    while (late()) await new Promise((done) => setTimeout(done, 20));
    await Promise.all(plot._promises || []);
  }
})()"""

LAST_PLANE_FIGURE = """(() => {
  const plot = Array.from(document.querySelectorAll(".plot")).filter((one) => one.querySelector(".nsewdrag")).at(-1);
  plot.scrollIntoView({ block: "start" });
  window.zoomed = plot;
  const box = plot.querySelector(".nsewdrag").getBoundingClientRect();
  return [box.left, box.top, box.width, box.height];
})()"""


ZOOMED_RANGE = "window.zoomed._fullLayout.xaxis.range.map((end) => typeof end === 'string' ? Date.parse(end) : end)"


def check_zoom(page: BrowserPage, width: int) -> None:
    """Dragging across a figure narrows its axis; a phone asks for it in the tool bar, so that a finger can scroll."""
    left, top, across, down = page.evaluate(LAST_PLANE_FIGURE)
    before = page.evaluate(ZOOMED_RANGE)
    if width == PHONE:
        assert page.evaluate("window.zoomed._fullLayout.dragmode") is False
        page.evaluate("window.zoomed.querySelector('.modebar-btn[data-val=zoom]').click()")
    y = top + down / 2
    page.drag(left + 0.3 * across, y, left + 0.6 * across, y)
    page.evaluate(SETTLED)
    after = page.evaluate(ZOOMED_RANGE)
    assert after != before
    share = (after[1] - after[0]) / (before[1] - before[0])
    assert share == pytest.approx(0.3, abs=0.1)


def check_sorting(page: BrowserPage) -> None:
    """A click on a heading of numbers sorts its table by them, a second one the other way."""
    column = """(() => {
      const table = document.querySelector("table.sortable");
      const place = Array.from(table.tHead.rows[0].cells).findIndex((cell) => cell.classList.contains("number"));
      table.tHead.rows[0].cells[place].querySelector("button").click();
      const raw = Array.from(table.tBodies[0].rows, (row) => row.cells[place].dataset.sort);
      return raw.filter((text) => text !== "").map(Number);
    })()"""
    rising, falling = page.evaluate(column), page.evaluate(column)
    assert len(rising) > 1
    assert rising == sorted(rising)
    assert falling == rising[::-1]


def check_downloads(page: BrowserPage, folder: Path) -> None:
    """The buttons give CSV files of the tables and of the figures' data."""
    names = page.evaluate("Array.from(document.querySelectorAll('button.download')).length")
    assert names >= page.evaluate("document.querySelectorAll('figure, table.sortable').length")
    for place, button in (("table", ".downloads .download"), ("figure", "figure .download")):
        (file,) = page.downloads(folder / place, f"document.querySelector('{button}').click()")
        with file.open(encoding="utf-8-sig", newline="") as opened:
            heading, *rows = csv.reader(opened)
        assert rows
        assert all(len(row) == len(heading) for row in rows)
        assert any(re.fullmatch(r"-?\d+(\.\d+)?(e-?\d+)?", cell) for row in rows for cell in row)


def check_parameters_print(page: BrowserPage, report: Path, bare: Path) -> None:
    """The table of 58 parameters takes four pages at most. Figures, and what else is on the page, are left out."""
    text = report.read_text(encoding="utf-8")
    bare.write_text(re.sub(r"<script[^>]* data-figure=.*?</script>", "", text, flags=re.DOTALL), encoding="utf-8")
    page.open(bare, WINDOW)
    others = "main > :not(#parameters), #parameters figure"
    page.evaluate(f"document.querySelectorAll('{others}').forEach((one) => one.remove())")
    printed = page.pdf()
    assert 1 <= len(re.findall(rb"/Type\s*/Page\b", printed)) <= MOST_PRINTED_PAGES
