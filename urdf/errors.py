"""The two ways in which kincal says no, and their kinds."""

from __future__ import annotations

from collections.abc import Iterable

OUT_OF_MEMORY = (
    "out of memory; finished results stay in the store. Close other programs, use fewer workers (--on), or less data: "
    "fewer poses, a shorter stream"
)
_LONGEST = 1000  # letters of a message: a list of names may be long
MOST_SHOWN = 80  # letters that a message shows of a text or a list
_QUOTED = 50  # of a value: a message that names it twice still shows no more than MOST_SHOWN
_LONGEST_PATH = 400  # letters


class InputError(ValueError):
    """Bad input: one line that names the file, the field, what was found and what is allowed (exit status 2)."""

    def __init__(self, message: str) -> None:
        super().__init__(one_line(message))


class CalibrationError(RuntimeError):
    """The calibration failed its own checks; nothing is exported (exit status 1)."""

    def __init__(self, message: str) -> None:
        super().__init__(one_line(message))


def of_system(error: OSError) -> str:
    """What a system says of a file that it refuses."""
    return f"{error.filename or 'the output'}: {error.strerror or error}"


def one_line(message: str) -> str:
    """As a terminal may show it: no control characters, and the middle of long messages and long words cut out."""
    words = _printable(message, 10 * _LONGEST).split(" ")
    return _cut(" ".join(_word(word) if len(word) > MOST_SHOWN else word for word in words), _LONGEST)


def quoted(value: object) -> str:
    """A value of a file, with Python's quotes, as messages show it: printable, the middle of a long one cut out."""
    try:
        text = repr(value if not isinstance(value, str) else _cut(value, 10 * MOST_SHOWN))
    except (ValueError, RecursionError):  # a whole number of thousands of digits; a list in a list in a list ..
        return f"a {type(value).__name__} that is too long to be shown"
    return shortened(text, _QUOTED)


def shortened(text: object, most: int = MOST_SHOWN) -> str:
    """A name or a text of a file as messages show it: `most` printable letters, the middle of a longer one cut out."""
    return _cut(_printable(str(text), 10 * _LONGEST), most)


def _printable(text: str, most: int) -> str:
    return "".join(c if c.isprintable() else "?" for c in " ".join(_cut(text, most).split()))


def _cut(text: str, most: int) -> str:
    end = most // 4
    return text if len(text) <= most else f"{text[: most - end - 3]}...{text[-end:]}"


def _word(word: str) -> str:
    """What stands between two blanks; of a path each part may be long."""
    if "/" not in word:
        return _cut(word, MOST_SHOWN)
    return _cut("/".join(_cut(part, MOST_SHOWN) for part in word.split("/")), _LONGEST_PATH)


# Errors where a caller can act on more than the message.


class UnknownNameError(InputError):
    """A robot, a stage, a method or a format that does not exist.

    Attributes
    ----------
    name
        What was asked for.
    allowed
        The names that exist.
    """

    def __init__(self, message: str, name: str, allowed: Iterable[str]) -> None:
        super().__init__(message)
        self.name = name
        self.allowed = tuple(allowed)


class TableError(InputError):
    """A table that cannot be used.

    Attributes
    ----------
    column
        The column that is missing or holds the value; None: the table as a whole.
    row
        The row of the value, from 0; None: no single one.
    """

    def __init__(self, message: str, column: str | None = None, row: int | None = None) -> None:
        super().__init__(message)
        self.column = column
        self.row = row


class UnreachablePoseError(InputError):
    """A desired pose that the robot cannot reach.

    Attributes
    ----------
    pose
        Its number.
    """

    def __init__(self, message: str, pose: int) -> None:
        super().__init__(message)
        self.pose = pose


class NotConvergedError(CalibrationError):
    """An iteration that came to no end: the result would mean nothing."""


class MovedFarError(CalibrationError):
    """A parameter moved farther from the drawing than its tolerance allows.

    Attributes
    ----------
    reason
        Which, and how far, without advice.
    """

    def __init__(self, message: str, reason: str) -> None:
        super().__init__(message)
        self.reason = reason
