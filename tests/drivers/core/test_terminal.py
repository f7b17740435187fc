"""Text from outside commands no terminal, and is not lost."""

from __future__ import annotations

import io
import json
import sys
import unicodedata

from hypothesis import given
from hypothesis import strategies as st

from drivers.core.terminal import VisibleStream, hidden_character, show_visibly, styled, visible

# Any character, lone halves of pairs included; those that command a terminal often.
TEXT = st.text(st.characters() | st.sampled_from("\x1b\x07\x9b\x08\r\x00\u202e\u2066\u2028\udc80"))


@given(TEXT)
def test_no_character_commands_a_terminal_and_all_can_be_encoded(text):
    shown = visible(text)
    assert all(unicodedata.category(c) not in ("Cc", "Cs", "Zl", "Zp") or c in "\n\t" for c in shown)
    assert not any(unicodedata.bidirectional(c) in ("LRE", "RLE", "LRO", "RLO", "PDF", "LRI", "RLI") for c in shown)
    shown.encode("utf-8")
    assert visible(shown) == shown


@given(TEXT)
def test_json_keeps_its_content(text):
    assert json.loads(visible(json.dumps({"name": text}, ensure_ascii=False, indent=1))) == {"name": text}


def test_other_text_is_as_it_was():
    text = "π/2 rad\t±0.1 °C\nKöln 東京 – ✓ é"
    assert visible(text) == text


@given(st.lists(TEXT))
def test_a_stream_writes_nothing_else(texts):
    out = io.StringIO()
    stream = VisibleStream(out)
    assert [stream.write(text) for text in texts] == [len(text) for text in texts]
    stream.writelines(texts)
    assert out.getvalue() == visible("".join(texts)) * 2


def test_a_process_prints_visibly_however_often_it_is_asked_to(capsys):
    show_visibly()
    beneath = styled(sys.stdout)
    show_visibly()
    assert styled(sys.stdout) is beneath
    print("a\x1b[2Jb")
    print("c\x07", file=sys.stderr)
    assert capsys.readouterr() == ("a\\u001b[2Jb\n", "c\\u0007\n")
    assert not sys.stdout.isatty()


@given(TEXT, st.sampled_from(["ascii", "latin-1", "cp1252"]))
def test_what_an_encoding_lacks_is_escaped_as_json_has_it(text, encoding):
    raw = io.BytesIO()
    stream = VisibleStream(io.TextIOWrapper(raw, encoding=encoding, errors="dynid.escaped"))
    print(json.dumps({"name": text}, ensure_ascii=False), file=stream, flush=True)
    assert json.loads(raw.getvalue().decode(encoding)) == {"name": text}


@given(TEXT)
def test_a_name_without_hidden_characters_is_shown_as_it_is(text):
    if not hidden_character(text):
        assert visible(text) == text
        assert text.isprintable() or not {"\n", "\t"} & set(text)
