"""The sentences that people read, in the documentation and in the code."""

import re

import pytest

from tests.messages import messages
from tests.sentences import LONGEST, faults, sentences
from tests.sources import ROOT

PAGES = [ROOT / "README.md", ROOT / "CHANGELOG.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
_RIDDLES = re.compile(r"\b(told|tells?|survives?|pays|believed|stands there|taken for|whatever)\b")


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_pages(page):
    """At most 25 words a sentence, none of the words and openings that have to be decoded."""
    found = list(sentences(page.read_text(encoding="utf-8")))
    assert found
    assert [f"{fault}: {s}" for s in found for fault in faults(s)] == []


def test_messages():
    """Each part of a message, between colons and semicolons, is short; and no message has a riddling word."""
    found = list(messages())
    assert len(found) > 250
    wrong = []
    for file, line, text in found:
        parts = re.split(r"[:;.(]\s", " ".join(text.split()))
        if any(len(part.split()) > LONGEST + 5 for part in parts) or _RIDDLES.search(text):
            wrong.append(f"{file}:{line}: {text}")
    assert wrong == []


def test_the_checker_sees_what_is_wrong():
    long = "This sentence has many more words " + "than a reader can keep in mind at once, " * 3 + "so it must be cut."
    short = ("What was not measured is never invented.", "It pays.", "It is short.")
    assert [len(faults(s)) for s in (long, *short)] == [1, 1, 1, 0]
    text = "# A long heading\n\nOne sentence. Two `code. blocks`; and more.\n\n| a | b |\n\n```\ncode\n```\n- item"
    assert list(sentences(text)) == ["One sentence.", "Two Code; and more.", "item"]
