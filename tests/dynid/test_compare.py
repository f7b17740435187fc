"""Methods compared on the same held-out recordings, by the API and by the command."""

from __future__ import annotations

import json
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from dataclasses import replace

import command_line
import numpy as np
import pytest
from each import each

import dynid
from drivers.core.errors import UsageError
from ident.identify.data_split import labelled
from ident.tasks import comparison as comparison_task

pytestmark = pytest.mark.usefixtures("stated_friction", "estimates_alone")


@pytest.fixture(scope="module")
def runs() -> list[dynid.Recording]:
    """Four recordings of a small arm."""
    return [dynid.simulate("up6", duration=6.0, seed=seed, rate=100.0) for seed in (1, 2, 3, 4)]


@pytest.fixture(scope="module")
def comparison(runs) -> dynid.MethodComparison:
    return dynid.compare(runs[0], ("ols", "wls"), friction=("coulomb-viscous", "viscous"), validation=runs[1:])


def test_every_method_meets_every_friction_model_on_every_recording(comparison):
    assert [model.label for model in comparison.models if model.parameters == "full"] == [
        "ols, coulomb-viscous",
        "ols, viscous",
        "wls, coulomb-viscous",
        "wls, viscous",
    ]
    assert all(len(model.runs) == 3 and model.seconds > 0 for model in comparison.models)
    assert len(comparison.recordings) == 3


def test_errors_are_those_of_an_identification(comparison, runs):
    result = dynid.identify(runs[0], validation=runs[1], method="wls", friction="coulomb-viscous")
    model = next(one for one in comparison.models if one.label == "wls, coulomb-viscous")
    assert model.runs[0].relative_error == pytest.approx(result.validation.relative_error, rel=1e-9)
    assert model.fit == pytest.approx(result.fit.relative_error, rel=1e-9)
    rmse = np.sqrt(np.mean(np.square(result.validation.rmse)))  # no joint rests: as many samples of each
    assert model.runs[0].rmse == pytest.approx(rmse, rel=0.05)
    largest = max(*model.runs[0].low_speed_max, *model.runs[0].high_speed_max)
    assert largest == pytest.approx(max(result.validation.max_error), rel=1e-9)


def test_a_cluster_compares_the_same_from_paths(comparison, runs, tmp_path):
    distributed = pytest.importorskip("distributed", reason="needs the extra 'dask'")
    paths = [tmp_path / f"{number}.h5" for number in range(4)]
    for run, path in zip(runs, paths, strict=True):
        run.save(path)
    with distributed.LocalCluster(n_workers=1, processes=False, dashboard_address=None) as local:
        scheduler = local.scheduler_address
        chosen = {"friction": ["coulomb-viscous"], "validation": paths[1:], "scheduler": scheduler}
        far = dynid.compare(paths[0], ["wls", "ols"], **chosen)
        with pytest.raises(UsageError, match="read recordings by path"):
            dynid.compare(runs[0], scheduler=scheduler)
    here = {model.label: model for model in comparison.models}
    assert [model.label for model in far.models if model.parameters == "full"] == [
        "wls, coulomb-viscous",
        "ols, coulomb-viscous",
    ]
    assert all(model.runs == here[model.label].runs for model in far.models)


def test_what_a_lost_scheduler_had_is_named(monkeypatch):
    class Lost(ThreadPoolExecutor):
        def submit(self, fn, options, case):
            assert all(path.is_absolute() for path in (*options.runs, *options.validation))
            raised: Future[None] = Future()
            raised.set_exception(CancelledError())
            return raised

    monkeypatch.setattr(comparison_task, "cluster_executor", lambda _: Lost(1))
    with pytest.raises(dynid.IdentificationError, match="no method has a solution; ols: the scheduler was lost"):
        dynid.compare("run.h5", ["ols"], validation=["other.h5"], scheduler="tcp://elsewhere")


def test_the_wrong_friction_model_is_significantly_worse(comparison):
    rows = {row["model"]: row for row in comparison.differences}
    assert rows["ols, viscous"]["significant"] == "yes"
    assert rows["ols, viscous"]["difference"] > rows["ols, viscous"]["interval"] > 0


def test_one_recording_gives_no_interval(runs):
    comparison = dynid.compare(runs[0], ("ols", "wls"), friction=["none"])
    assert [column.name for column in comparison.differences.columns] == ["model", "difference", "relative"]
    assert not [column.name for column in comparison.maxima.columns if column.name.endswith("std")]
    assert len(comparison.recordings) == 1


def test_errors_name_the_recordings_that_are_not_held_out(comparison):
    label = labelled("run.h5", 0.5)
    assert "NOT held out: 50 %" in label
    named = replace(comparison, recordings=("val.h5", label))
    for words in (str(named), named._repr_html_(), named._page()):
        assert label in words
    assert "NOT" not in str(comparison)


@each(
    ("options", "message"),
    [
        ({"methods": ("magic",)}, "no method is called 'magic'"),
        ({"methods": "wls"}, "must be a list"),
        ({"methods": ()}, "no method to compare"),
        ({"methods": ("wls", "wls")}, "given twice"),
        ({"friction": ("sticky",)}, "no friction model is called 'sticky'"),
        ({"friction": "viscous"}, "must be a list"),
    ],
)
def test_bad_options_are_refused_in_one_line(runs, options, message):
    with pytest.raises(dynid.UsageError, match=message) as refused:
        dynid.compare(runs[0], **options)
    assert "\n" not in str(refused.value)


def test_the_command_writes_figures_and_page_and_never_over_its_input(run_dynid, monkeypatch, tmp_path, runs):
    monkeypatch.chdir(tmp_path)
    for number, run in enumerate(runs[:3]):
        dynid.write_recording(f"run{number}.h5", run)

    def call(*arguments: str) -> tuple[int, str]:
        status, out, err = run_dynid("compare", *arguments)
        return status, out + err

    files = ("run0.h5", "--validate", "run1.h5", "--validate", "run2.h5")
    status, out = call(*files, "--methods", "ols,energy", "-o", "out", "--json")
    assert status == 0
    printed = json.loads(out)
    assert printed == command_line.stored(tmp_path / "out" / "comparison.json")
    assert [model["method"] for model in printed["models"]][::2] == ["ols", "energy"]
    page = (tmp_path / "out" / "report.html").read_text()
    assert "Largest errors" in page
    status, out = call(*files, "-o", "out")
    assert status == 2
    assert "--force" in out
    status, out = call(*files, "--methods", ",")
    assert (status, "--methods ',' contains no name" in out) == (2, True)
