"""The comparison of docs' tables with what studies print: what agrees, what is stale, what a comment may say."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def check():
    path = ROOT / "studies" / "check.py"
    spec = importlib.util.spec_from_file_location("studies_check", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules["studies_check"] = module
    spec.loader.exec_module(module)
    return module


PAGE = """
<!-- measured: python -m studies.folder.a 3 | skip: CPU s -->

| arm | error [%] | kept | CPU s |
|---|---|---|---|
| `ur10`, public | 6.85 | 1,661 | 3 |
| panda | −0.99 | 42 | 5 |
"""
PRINTED = """some text 12 13 14
| arm | error [%] | kept | CPU s |
|---|---|---|---|
| panda | -0.991 | 42 | 77 |
| ur10, public | 6.849 | 1661 | 8 |
"""


def stale(check, page: str, printed: str) -> list[str]:
    (table,) = check.tables_of("page.md", page)
    rows = check.printed_rows(printed, table.measurement.skip)
    return [row.text.split(" | ")[0] for row, _ in check.stale_rows(table, rows)]


def test_rows_that_agree_to_the_last_digit_are_not_stale(check):
    assert stale(check, PAGE, PRINTED) == []


@pytest.mark.parametrize(
    ("changed", "names"),
    [
        (("6.849", "6.2"), ["`ur10`, public"]),
        (("| 42 |", "| 45 |"), ["panda"]),
        (("-0.991", "0.991"), ["panda"]),
        (("| panda | -0.991 | 42 | 77 |\n", ""), ["panda"]),
        (("| 8 |", "| 8000 |"), []),  # a column left out
        (("1661", "1660"), []),  # one of the last digit
    ],
)
def test_a_changed_figure_is_stale(check, changed, names):
    assert changed[0] in PRINTED
    assert stale(check, PAGE, PRINTED.replace(*changed)) == names


def test_figures_of_other_words_are_found_by_their_numbers(check):
    assert stale(check, PAGE, "1 UR10: 6.9\nUR10 = 6.85 at 1661\nPanda -0.99 of 42\n") == []


def test_a_table_of_another_shape_has_its_numbers_anywhere(check):
    page = PAGE.replace("| skip: CPU s", "| anywhere")
    printed = "6.8461 of 1661\n-0.9900 0.42 3 5"  # 42 % printed as 0.42
    assert stale(check, page, printed) == []
    assert stale(check, page, printed.replace("6.8461", "6.86")) == ["`ur10`, public"]


def test_the_tolerance_is_relative(check):
    page = PAGE.replace("skip: CPU s", "skip: CPU s | within: 10 %")
    assert stale(check, page, PRINTED.replace("6.849", "6.3")) == []
    assert stale(check, page, PRINTED.replace("6.849", "6.2")) == ["`ur10`, public"]


@pytest.mark.parametrize(
    "comment",
    [
        "<!-- measured: rm -rf / -->",
        "<!-- measured: python -m studies.a | skipp: x -->",
        "<!-- measured: python -m studies.a | skip: x -->",
    ],
)
def test_comments_that_cannot_be_read_name_their_place(check, comment):
    page = "\n".join([comment, *PAGE.splitlines()[2:]])
    with pytest.raises(ValueError, match=r"docs/page\.md:\d"):
        list(check.tables_of("page.md", page))


def test_a_table_that_cannot_be_measured_again_says_why(check):
    (table,) = check.tables_of(
        "page.md", PAGE.replace("measured: python -m studies.folder.a 3 | skip: CPU s", "measured once: by hand")
    )
    assert (table.measurement.command, table.measurement.reason) == ("", "by hand")


def test_stale_rows_are_replaced_by_printed_ones_of_the_same_heading(check):
    (table,) = check.tables_of("page.md", PAGE)
    lines = PAGE.split("\n")
    written = check.rewritten(table, lines, PRINTED.replace("6.849", "7.1"))
    assert [lines[place].split()[1] for place in sorted(written)] == ["`ur10`,", "panda"]
    assert [line.split("|")[2].strip() for _, line in sorted(written.items())] == ["7.1", "-0.991"]
    assert check.rewritten(table, lines, PRINTED.replace("kept", "left")) == {}  # another heading
    assert check.rewritten(table, lines, PRINTED.replace("panda", "kuka")) == {}  # a row less
    assert check.rewritten(table, lines, PRINTED + "| panda | -0.991 | 42 | 77 |\n") == {}  # which of the two


def test_a_table_says_when_it_was_measured(check, monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(check, "ROOT", tmp_path)
    page = tmp_path / "docs" / "page.md"
    page.parent.mkdir()
    page.write_text(PAGE + "\nText.\n", encoding="utf-8")
    for at in ("0.1.0, commit 5e5a60a, 2026-11-22", "0.2.0, commit 0123abc, 2027-01-01"):
        check.stamp(check.all_tables(page.parent)[0], at)
        (table,) = check.all_tables(page.parent)
        assert table.at == at
        assert page.read_text(encoding="utf-8") == f"{PAGE}\n*Measured at {at}.*\n\nText.\n"
        check.show_list([table])
        assert capsys.readouterr().out.endswith(f"; measured at {at}\n")


@pytest.mark.parametrize(
    ("stated", "measured", "same"),
    [("70 000", "69,500", True), ("4e-16", "4.4e-16", True), ("4e-16", "6e-16", False), ("0.0", "0.04", True)],
)
def test_numbers(check, stated, measured, same):
    assert check.NUMBER.findall(stated) == [stated]
    assert check.agree(stated, measured, 0.02) is same


def test_every_comment_of_the_docs_can_be_read_and_names_a_study(check):
    measured = [table for table in check.all_tables(ROOT / "docs") if table.measurement is not None]
    assert len(measured) > 50
    for table in measured:
        if table.measurement.command:
            study = table.measurement.command.split()[2].replace(".", "/")
            assert (ROOT / f"{study}.py").is_file(), table.place
        else:
            assert table.measurement.reason, table.place
