"""The templates' Python that is kept between processes."""

from __future__ import annotations

from pathlib import Path

import pytest

from ident.report.html_file import page_templates

PAGE = "page.html.j2"


def test_what_templates_become_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tmp_path.chmod(0o700)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    page_templates.__wrapped__().get_template(PAGE)
    kept = list((tmp_path / "dynid").glob("page-*.cache"))
    assert kept
    kept[0].write_bytes(kept[0].read_bytes()[:-100])  # cut off: made anew
    again = page_templates.__wrapped__()
    monkeypatch.setattr(again, "_generate", None)
    with pytest.raises(TypeError):
        again.get_template(PAGE)
    page_templates.__wrapped__().get_template(PAGE)
    again.get_template(PAGE)  # without a line of it generated


def test_a_page_needs_no_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert page_templates.__wrapped__().get_template(PAGE)
