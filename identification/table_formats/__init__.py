"""Exports of motion capture software, read as they are. A new one is a file beside this one and a place in FORMATS.

Each is recognised by its first lines, not by its name. `export.Format` says what a file must hold.
"""

from __future__ import annotations

from collections.abc import Sequence

from kincal.identification.table_formats.export import Format
from kincal.identification.table_formats.motive import MOTIVE
from kincal.identification.table_formats.qualisys import QUALISYS

FORMATS: tuple[Format, ...] = (MOTIVE, QUALISYS)


def format_of(lines: Sequence[str]) -> Format | None:
    """The format of a file that begins with these lines; None: a plain table."""
    return next((form for form in FORMATS if form.recognises(lines)), None)
