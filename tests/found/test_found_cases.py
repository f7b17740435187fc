"""Damaged files over which a command once crashed, hung or printed a traceback: `cases/<kind>/<what>/<file>`."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from fuzzing.judged_run import run_command
from fuzzing.seed_files import COMMANDS, Seeds, make_seeds

from drivers.core import reading_process

CASES = sorted((Path(__file__).parent / "cases").glob("*/*/*"))


@pytest.fixture(scope="module")
def seeds(tmp_path_factory: pytest.TempPathFactory) -> Seeds:
    return make_seeds(tmp_path_factory.mktemp("seeds"))


@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case.parent.parent.name}-{case.parent.name}")
def test_a_found_case_is_answered(tmp_path: Path, monkeypatch, seeds: Seeds, case: Path) -> None:
    monkeypatch.setattr(reading_process, "TIME_LIMIT", 1.0)
    for arguments in COMMANDS[case.parent.parent.name](case.name):
        work = tmp_path / "work"
        shutil.copytree(seeds.folder, work)
        shutil.copy(case, work / case.name)
        assert run_command(arguments, work).problems == ()
        shutil.rmtree(work)
