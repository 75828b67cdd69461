"""Sentences that a reader would have to decode: too long, or with words and openings that kincal does not use.

`python -m tests.sentences FILE..` lists those of Markdown pages.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path

LONGEST = 25  # words
_WORDS = r"told|said|survives?|survived|pays|paid|believed|riddles?|whoever|whatever"  # measured, kept, trusted, ..
_OPENINGS = (
    r"What (?!is |are |does |do |if |to |kincal )[^?]*$",  # "What was not measured is .."; questions may
    r"(What|Who|Which) (is|are|was|were) [^?]*$",
    r"(Of|Nor|From) [^,]{0,60} (is|are|was|were) ",
    r"(That|Where) [^,]* is what ",
)
_END = re.compile(r"(?<=[.!?])[\"')*_]*\s+(?=[A-Z0-9`\"'(\[*]|kincal )")


def sentences(markdown: str) -> Iterator[str]:
    """Of the running text and of lists: no code, no tables, no headings."""
    for block in _blocks(markdown):
        text = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", " ".join(block.split()))
        text = re.sub(r"`[^`]*`", "Code", text).replace("e.g.", "eg").replace("i.e.", "ie").replace("et al.", "et al")
        yield from (s for s in _END.split(text.replace(" .. ", " - ")) if s)


def faults(sentence: str) -> list[str]:
    """What is wrong with it, a word or two each."""
    found = []
    words = [w for w in sentence.split() if re.search(r"\w", w)]
    if len(words) > LONGEST:
        found.append(f"{len(words)} words")
    found += [f"'{m}'" for m in re.findall(rf"\b({_WORDS})\b", sentence, flags=re.IGNORECASE)]
    found += ["chain of semicolons"] * (sentence.count(";") > 1)
    found += ["opening" for o in _OPENINGS if re.match(o, sentence)][:1]
    return found


def _blocks(markdown: str) -> Iterator[str]:
    markdown = re.sub(r"^```.*?^```", "\n\n", markdown, flags=re.S | re.M)
    block: list[str] = []
    for line in [*markdown.splitlines(), ""]:
        starts = re.match(r"\s*([-*]|\d+\.)\s+", line)
        if not line.strip() or starts or line.lstrip().startswith(("|", "#", "<", "!!!")):
            if block:
                yield "\n".join(block)
            block = []
        if starts:
            line = line[starts.end() :]
        if line.strip() and not line.lstrip().startswith(("|", "#", "<", "!!!")):
            block.append(line)


def main() -> None:
    """List the faults of pages."""
    count = 0
    for file in sys.argv[1:]:
        for sentence in sentences(Path(file).read_text(encoding="utf-8")):
            for fault in faults(sentence)[:1]:
                count += 1
                print(f"{file}: {fault}: {sentence}")
    print(f"{count} sentences to write anew")


if __name__ == "__main__":
    main()
