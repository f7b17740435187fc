"""Figures of docs/measurements against what studies print: what agrees, what is stale, what a comment may say."""

from __future__ import annotations

from pathlib import Path

import pytest
from each import each

from studies import check, pages

ROOT = Path(__file__).parents[1]


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


def stale(page: str, printed: str) -> list[str]:
    (table,) = pages.blocks_of("page.md", page)
    return [row.text.split(" | ")[0] for row, _ in check.stale_rows(table, printed)]


def test_rows_that_agree_to_the_last_digit_are_not_stale():
    assert stale(PAGE, PRINTED) == []


@each(
    ("changed", "names"),
    [
        (("6.849", "6.2"), ["`ur10`, public"]),
        (("| 42 |", "| 45 |"), ["panda"]),
        (("-0.991", "0.991"), ["panda"]),
        (("| panda | -0.991 | 42 | 77 |\n", ""), ["panda"]),
        (("| 8 |", "| 8000 |"), []),  # a column left out
        (("1661", "1660"), []),  # one of the last digit
        (("public", "hidden"), ["`ur10`, public"]),
        (("| panda", "| kuka | 1 | 2 | 3 |\n| panda"), ["panda"]),  # a row more
    ],
)
def test_a_changed_figure_is_stale(changed, names):
    assert changed[0] in PRINTED
    assert stale(PAGE, PRINTED.replace(*changed)) == names


def test_figures_of_other_words_are_found_by_their_numbers():
    assert stale(PAGE, "1 UR10: 6.9\nUR10 = 6.85 at 1661\nPanda -0.99 of 42\n") == []


def test_a_table_of_another_shape_has_its_numbers_anywhere():
    page = PAGE.replace("| skip: CPU s", "| anywhere")
    printed = "6.8461 of 1661\n-0.9900 0.42 3 5"  # 42 % printed as 0.42
    assert stale(page, printed) == []
    assert stale(page, printed.replace("6.8461", "6.86")) == ["`ur10`, public"]


def test_a_row_of_which_every_column_is_left_out_must_still_be_printed():
    page = PAGE.replace("skip: CPU s", "skip: CPU s; error [%]; kept")
    assert stale(page, PRINTED.replace("| ur10, public", "| `ur10`, public")) == []
    assert stale(page, "") == ["`ur10`, public", "panda"]


@pytest.mark.parametrize(("rows", "printed"), [(0, PRINTED), (2, "")])
def test_an_empty_table_is_an_error(monkeypatch, capsys, rows, printed):
    monkeypatch.setattr(check, "output_of", lambda *_: (printed, "", "now"))
    lines = PAGE.splitlines()
    tables = list(pages.blocks_of("page.md", "\n".join(lines[: 5 + rows])))
    assert not check.check(tables, 1.0)
    assert "FAILED" in capsys.readouterr().out


def test_the_tolerance_is_relative():
    page = PAGE.replace("skip: CPU s", "skip: CPU s | within: 10 %")
    assert stale(page, PRINTED.replace("6.849", "6.3")) == []
    assert stale(page, PRINTED.replace("6.849", "6.2")) == ["`ur10`, public"]


@each(
    "comment",
    [
        "<!-- measured: rm -rf / -->",
        "<!-- measured: python -m studies.a | skipp: x -->",
        "<!-- measured: python -m studies.a | skip: x -->",
    ],
)
def test_comments_that_cannot_be_read_name_their_place(comment):
    page = "\n".join([comment, *PAGE.splitlines()[2:]])
    with pytest.raises(ValueError, match=r"page\.md:\d"):
        list(pages.blocks_of("page.md", page))


def test_a_table_that_cannot_be_measured_again_says_why():
    (table,) = pages.blocks_of(
        "page.md", PAGE.replace("measured: python -m studies.folder.a 3 | skip: CPU s", "measured once: by hand")
    )
    assert (table.measurement.command, table.measurement.reason) == ("", "by hand")


def rewritten(page: str, printed: str, place: tuple[int, int] = (0, 1)) -> list[str]:
    (table,) = pages.blocks_of("page.md", page)
    return pages.rewritten(table, page.split("\n"), printed, place)


def test_a_table_is_replaced_by_the_printed_one_of_the_same_heading():
    more = PRINTED.replace("6.849", "7.1") + "| kuka | 3 | 1 | 2 |\n"
    assert rewritten(PAGE, more) == more.splitlines()[3:]
    assert rewritten(PAGE, PRINTED.replace("kept", "left")) == []  # another heading
    assert rewritten(PAGE, PRINTED + "\n" + PRINTED) == []  # which of the two
    assert rewritten(PAGE, PRINTED + "\n" + more, (1, 2)) == more.splitlines()[3:]
    assert rewritten(PAGE.replace("skip: CPU s", "anywhere"), PRINTED) == []


def test_a_selection_of_rows_stays_one():
    page = PAGE.replace("skip: CPU s", "part")
    more = PRINTED.replace("6.849", "7.1") + "| kuka | 3 | 1 | 2 |\n"
    assert [row.split()[1] for row in rewritten(page, more)] == ["ur10,", "panda"]
    assert rewritten(page, PRINTED.replace("panda", "kuka")) == []  # a row less
    assert rewritten(page, PRINTED + "| panda | -0.991 | 42 | 77 |\n") == []  # which of the two


TEXT = """
<!-- measured: python -m studies.folder.a -->

```text
ur10    6.85  inside 94.0 %
```
"""


def test_a_text_is_replaced_by_all_that_was_printed():
    assert stale(TEXT, "\nur10    6.85  inside 94.0 %\n") == []
    assert stale(TEXT, "ur10    7.85  inside 94.0 %\n") == ["ur10    6.85  inside 94.0 %"]
    assert rewritten(TEXT, "\ntitle\nur10    7.85  inside 94.0 %  \n") == ["title", "ur10    7.85  inside 94.0 %"]
    assert list(pages.blocks_of("page.md", TEXT.replace("<!-- measured: python -m studies.folder.a -->", ""))) == []


@pytest.mark.parametrize("page", [PAGE, TEXT], ids=["table", "text"])
def test_writing_renews_figures_checksum_and_the_line_below(monkeypatch, tmp_path, capsys, page):
    monkeypatch.setattr(pages, "ROOT", tmp_path)
    path = tmp_path / pages.MEASUREMENTS / "page.md"
    path.parent.mkdir(parents=True)
    path.write_text(page + "\nText.\n", encoding="utf-8")
    for figure, at in (("6.85", "0.1.0, commit 5e5a60a, 2026-11-22"), ("9.85", "0.2.0, commit 0123abc, 2027-01-01")):
        printed = (PRINTED.replace("6.849", figure) if page is PAGE else "ur10    6.85  inside 94.0 %\n").replace(
            "6.85", figure
        )
        monkeypatch.setattr(check, "output_of", lambda command, seconds, outputs, now=(printed, "", at): now)
        check.check(pages.all_blocks(tmp_path), 1.0, writing=True)
        (block,) = pages.all_blocks(tmp_path)
        assert (block.at, block.below["sum"]) == (at, block.checksum)
        text = path.read_text(encoding="utf-8")
        assert figure in text
        assert text.endswith(f"; version {at}.* <!-- block {block.checksum} -->\n\nText.\n")
        assert text.count("; version ") == 1
        path.write_text(text.replace(figure, "5.55"), encoding="utf-8")  # an edit by hand
        (edited,) = pages.all_blocks(tmp_path)
        assert edited.checksum != edited.below["sum"]
        path.write_text(text, encoding="utf-8")
    check.show_list(pages.all_blocks(tmp_path))
    assert capsys.readouterr().out.endswith("; measured at 0.2.0, commit 0123abc, 2027-01-01\n")


def test_kept_outputs_are_not_measured_again(monkeypatch, tmp_path):
    runs = []
    monkeypatch.setattr(check, "run", lambda command, seconds: (runs.append(command), ("1 2\n", ""))[1])
    monkeypatch.setattr(check, "now", lambda: "0.1.0, commit 5e5a60a, 2026-11-22")
    command = "python -m studies.folder.a 3"
    first = check.output_of(command, 1.0, tmp_path)
    monkeypatch.setattr(check, "now", lambda: "0.1.0, commit 0123abc, 2026-11-23")
    assert check.output_of(command, 1.0, tmp_path) == first == ("1 2\n", "", "0.1.0, commit 5e5a60a, 2026-11-22")
    assert check.output_of(command, 1.0, None)[2] == "0.1.0, commit 0123abc, 2026-11-23"
    assert runs == [command, command]


@each(
    ("stated", "measured", "same"),
    [("70 000", "69,500", True), ("4e-16", "4.4e-16", True), ("4e-16", "6e-16", False), ("0.0", "0.04", True)],
)
def test_numbers(stated, measured, same):
    assert pages.NUMBER.findall(stated) == [stated]
    assert check.agree(stated, measured, 0.02) is same


def test_every_block_of_the_measurements_says_how_and_when_and_is_as_it_was_written():
    """A figure that was edited by hand changes the checksum: `python studies/check.py --write` writes figures."""
    blocks = pages.all_blocks(ROOT)
    assert len(blocks) > 50
    for block in blocks:
        if block.measurement is None:
            assert not block.of_figures, block.place
            continue
        assert block.below is not None, block.place
        assert block.below["sum"] == block.checksum, block.place
        assert (block.below["command"] or "") == block.measurement.command, block.place
        assert (block.below["reason"] or "") == block.measurement.reason, block.place
        if block.measurement.command:
            study = block.measurement.command.split()[2].replace(".", "/")
            assert (ROOT / f"{study}.py").is_file(), block.place


@each("page", sorted((ROOT / "docs").glob("*.md")))
def test_pages_for_users_leave_tables_of_figures_to_the_measurements(page):
    """`<!-- no measurement: … -->` says of a table of numbers that nothing was measured: limits, arithmetic."""
    text = page.read_text(encoding="utf-8")
    assert "<!-- measured" not in text
    lines = text.splitlines()
    for block in pages.blocks_of(page.name, text):
        above = [line for line in lines[: block.line - 1][-2:] if line.strip()]
        assert not block.of_figures or above[-1].startswith("<!-- no measurement: "), block.place


def test_tables_made_by_hand_give_way_to_what_was_printed(monkeypatch, tmp_path):
    monkeypatch.setattr(pages, "ROOT", tmp_path)
    path = tmp_path / pages.MEASUREMENTS / "page.md"
    path.parent.mkdir(parents=True)
    hand = PAGE.replace("skip: CPU s", "anywhere")
    other = PAGE.replace("folder.a 3 | skip: CPU s", "folder.b").replace("panda", "kuka")
    path.write_text(f"# Page\n{hand}\nBetween.\n{other}\n{hand.replace('6.85', '6.95')}\nEnd.\n", encoding="utf-8")
    at = "0.1.0, commit 5e5a60a, 2026-11-22"

    def printed(command: str, seconds: float, outputs: object) -> tuple[str, str, str]:
        return ("ur10 7.1\npanda 2\n" if command.endswith("3") else PRINTED.replace("panda", "kuka")), "", at

    monkeypatch.setattr(check, "output_of", printed)
    check.check(pages.all_blocks(tmp_path), 1.0, writing=True)
    blocks = pages.all_blocks(tmp_path)
    assert [(block.heading[:1], block.measurement.anywhere) for block in blocks] == [((), False), (("arm",), False)]
    assert all(block.at == at and block.below["sum"] == block.checksum for block in blocks)
    text = path.read_text(encoding="utf-8")
    assert "```text\nur10 7.1\npanda 2\n```" in text
    assert text.index("7.1") < text.index("Between.") < text.index("kuka") < text.index("End.")
    assert "6.95" not in text
    assert check.check(blocks, 1.0)


def test_printed_tables_become_blocks_of_their_own():
    lines = pages.new_blocks("python -m studies.folder.a", f"{PRINTED}\n{PRINTED}", "0.1.0, commit 5e5a60a, 2026-11-22")
    blocks = list(pages.blocks_of("page.md", "\n".join(lines)))
    assert [block.lines for block in blocks] == [2, 2]
    assert all(block.below["sum"] == block.checksum for block in blocks)
