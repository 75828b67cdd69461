"""The two ways in which kincal says no, and their kinds."""

from __future__ import annotations

from collections.abc import Iterable

_LONGEST = 1000  # letters of a message: what was found may be a whole file


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
    """As a terminal may show it, whatever names and values a file holds: no control characters, the middle cut out."""
    if len(message) > 10 * _LONGEST:
        message = message[: 5 * _LONGEST] + message[-5 * _LONGEST :]
    shown = "".join(c if c.isprintable() else "?" for c in " ".join(message.split()))
    return shown if len(shown) <= _LONGEST else f"{shown[: 3 * _LONGEST // 4]} ... {shown[-_LONGEST // 4 :]}"


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
