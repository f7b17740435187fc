"""Real-time priority: asked for, refused in words, handed on to threads, and not to a display."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from daq.session import realtime
from drivers.core.errors import UsageError

linux = pytest.mark.skipif(not hasattr(os, "sched_setscheduler"), reason="Linux only")

PROBE = """
import os, subprocess, sys, threading
from daq.session.realtime import ask_for_realtime, ordinary_priority
ask_for_realtime()
seen = []
thread = threading.Thread(target=lambda: seen.append(os.sched_getscheduler(0)))
thread.start(); thread.join()
assert seen == [os.SCHED_FIFO], seen
with ordinary_priority():
    assert os.sched_getscheduler(0) == os.SCHED_OTHER
    assert int(subprocess.check_output([sys.executable, "-c", "import os; print(os.sched_getscheduler(0))"])) == 0
assert os.sched_getscheduler(0) == os.SCHED_FIFO
print("done")
"""


@linux
def test_threads_that_are_started_later_have_it_too():
    run = subprocess.run([sys.executable, "-c", PROBE], capture_output=True, text=True, check=False)
    if "refused" in run.stderr:
        pytest.skip("this system does not allow real-time priority")
    assert run.stdout == "done\n", run.stderr


@linux
def test_a_refusal_says_how_it_is_allowed(monkeypatch):
    def refuse(*_):
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    with pytest.raises(UsageError, match="Operation not permitted") as caught:
        realtime.ask_for_realtime()
    assert "limits.d" in str(caught.value.hint)


def test_a_system_without_it_says_so(monkeypatch):
    monkeypatch.delattr(os, "sched_setscheduler", raising=False)
    with pytest.raises(UsageError, match="no real-time priority"):
        realtime.ask_for_realtime()
    with realtime.ordinary_priority():
        pass


@linux
def test_trying_leaves_this_thread_as_it_was():
    before = os.sched_getscheduler(0)
    assert realtime.may_have_realtime() in (True, False)
    assert os.sched_getscheduler(0) == before


def test_a_refusal_is_seen_by_trying(monkeypatch):
    def refuse():
        raise UsageError("no")

    monkeypatch.setattr(realtime, "ask_for_realtime", refuse)
    assert realtime.may_have_realtime() is False


def test_the_processor_is_kept_awake_where_the_system_allows_it(tmp_path, monkeypatch):
    for path, written in ((tmp_path / "latency", bytes(4)), (tmp_path / "nowhere" / "latency", b"")):
        monkeypatch.setattr(realtime, "WAKE_LATENCY", path)
        with realtime.awake_processor():
            assert (path.read_bytes() if path.exists() else b"") == written
