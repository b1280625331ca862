"""The check of words: it finds those of the list in prose, and ignores code."""

import pytest

from experiments.checks.words import found_words, load_words, prose_of

WORDS = {"anew": "again", "colour*": "color", "at hand": "available"}


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("Drawn anew.", [(1, "anew", "again")]),
        ("one\nColours\nat\nhand", [(2, "Colours", "color"), (3, "at\nhand", "available")]),
        ("renewed `anew` [text](anew.md) <!-- anew -->", []),
        ("```sh\nanew\n```\nanew", [(4, "anew", "again")]),
    ],
)
def test_found_words(text, expected):
    assert list(found_words(text, WORDS)) == expected


def test_comments_and_docstrings_of_programs_are_prose(tmp_path):
    file = tmp_path / "a.py"
    file.write_text('anew = "anew"  # drawn anew\n\n\ndef f():\n    """Do.\n\n    Anew.\n    """\n')
    assert list(found_words(prose_of(file), WORDS)) == [(1, "anew", "again"), (7, "Anew", "again")]


def test_list_is_sorted_and_complete():
    words = load_words()
    assert list(words) == sorted(words)
    assert all(words.values())
