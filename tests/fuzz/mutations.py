"""Ways to spoil a file: its bytes, whatever it is, and its structure."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from random import Random

Mutation = Callable[[bytes, Random], bytes]

NUMBERS = (
    *("nan", "NaN", "inf", "-inf", "1e999", "-1e308", "1e308", "5e-324", "1e-400", "0", "-0", "-1", "-0.0", "1e9"),
    *("2147483648", "18446744073709551616", "-9223372036854775809", "9" * 400, "1" * 5000, "0x" + "f" * 5000),
    *("1_000", "1,5", "0.0.0", "--1", "", " ", "true", "null", "None", "\u0663", "1e", "0b1", "1979-05-27"),
)  # fmt: skip
TEXTS = (
    *('"', "'", "\\", "\0", "\r", "\n", "\r\n", "\t", "\x1b[31m", "\x07", "\u202e", "\ufeff", "é", "\U0001f916"),
    *("<script>alert(1)</script>", "*/", "/*", "??/", "%s%n", "${HOME}", "$(id)", "`id`", "{{7*7}}", "]]>", "&a;"),
    *("../../../etc/passwd", "/dev/zero", "/dev/stdin", "/proc/self/mem", "/", ".", "..", "~", "C:\\", "file:///a"),
    *("A" * 300, "A" * 100_000, "[" * 5000, "<a>" * 5000, "(" * 3000, ",", ";", "#", "a." * 3000 + "a=1\n"),
    *("{a=" * 2000, "__class__", "\ud7ff", "CON", "con", "int", "1", "-", "\x85", "\xa0"),
)  # fmt: skip
_NUMBER = re.compile(rb"[-+]?\d+(\.\d+)?([eE][-+]?\d+)?")


def _place(content: bytes, random: Random) -> tuple[int, int]:
    """Begin and end of a short stretch, or now and then a long one."""
    begin = random.randrange(len(content) + 1)
    length = random.choice((1, 1, 2, 4, 8, 32, 256, max(len(content) // 3, 1)))
    return begin, min(begin + random.randint(1, length), len(content))


def flip(content: bytes, random: Random) -> bytes:
    spoiled = bytearray(content)
    for _ in range(random.choice((1, 1, 2, 8)) if content else 0):
        spoiled[random.randrange(len(spoiled))] ^= 1 << random.randrange(8)
    return bytes(spoiled)


def overwrite(content: bytes, random: Random) -> bytes:
    begin, end = _place(content, random)
    filler = random.choice((b"\0", b"\xff", b"\x7f", b"\x80", b" ", b"\n", b"9", None))
    new = random.randbytes(end - begin) if filler is None else filler * (end - begin)
    return content[:begin] + new + content[end:]


def delete(content: bytes, random: Random) -> bytes:
    begin, end = _place(content, random)
    return content[:begin] + content[end:]


def duplicate(content: bytes, random: Random) -> bytes:
    begin, end = _place(content, random)
    return content[:end] + content[begin:end] * random.choice((1, 1, 2, 100)) + content[end:]


def splice(content: bytes, random: Random) -> bytes:
    begin, end = _place(content, random)
    at = random.randrange(len(content) + 1)
    return content[:at] + content[begin:end] + content[at:]


def truncate(content: bytes, random: Random) -> bytes:
    return content[: random.choice((0, 1, 8, random.randrange(len(content) + 1), max(len(content) - 1, 0)))]


def number(content: bytes, random: Random) -> bytes:
    """One of its numbers becomes another one, or none."""
    found = list(_NUMBER.finditer(content))
    if not found:
        return insert(content, random)
    match = random.choice(found)
    return content[: match.start()] + random.choice(NUMBERS).encode() + content[match.end() :]


def insert(content: bytes, random: Random) -> bytes:
    at = random.randrange(len(content) + 1)
    return content[:at] + random.choice(TEXTS).encode() + content[at:]


def recode(content: bytes, random: Random) -> bytes:
    """Another encoding, a byte order mark, other line ends."""
    text = content.decode("utf-8", errors="replace")
    return random.choice(
        (
            lambda: b"\xef\xbb\xbf" + content,
            lambda: content.replace(b"\n", b"\r\n"),
            lambda: content.replace(b"\n", b"\r"),
            lambda: text.encode("utf-16"),
            lambda: text.encode("utf-32-be"),
            lambda: text.replace("e", "é").encode("latin-1", errors="replace"),
            lambda: content.replace(b" ", b"\xc2\xa0"),
            lambda: content + b"\x1a",
        )
    )()


BYTES: tuple[Mutation, ...] = (flip, overwrite, delete, duplicate, splice, truncate)
TEXTUAL: tuple[Mutation, ...] = (*BYTES, number, number, number, insert, insert, recode)


def several(mutations: Sequence[Mutation], content: bytes, random: Random) -> bytes:
    """One mutation, now and then a few on top of each other."""
    for _ in range(random.choice((1, 1, 1, 2, 4))):
        content = random.choice(mutations)(content, random)
    return content
