"""How large a spreadsheet is, asked in a process of its own.

A sheet of two cells may span seventeen thousand million. The reader reserves memory for all of them, and ends its
process where there is not so much.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from kincal.urdf.errors import InputError
from kincal.urdf.input_files import MAX_UNPACKED

MAX_SHEET_CELLS = 10_000_000  # of all sheets, empty ones among the others included
_SECONDS = 60  # for the largest files that are read at all
_SIZES = """
import sys
try:
    import resource
    resource.setrlimit(resource.RLIMIT_AS, (int(sys.argv[2]),) * 2)
except ImportError:
    pass
from python_calamine import load_workbook
book = load_workbook(sys.argv[1])
for name in book.sheet_names:
    sheet = book.get_sheet_by_name(name)
    print(sheet.total_height, sheet.total_width)
"""


def check_workbook(file: Path) -> None:
    """Raises InputError for a workbook of too many cells. One that is damaged is its reader's business."""
    if not sys.executable:
        return
    command = [sys.executable, "-I", "-c", _SIZES, str(file), str(2 * MAX_UNPACKED)]
    try:
        done = subprocess.run(command, capture_output=True, stdin=subprocess.DEVNULL, timeout=_SECONDS, check=False)
    except subprocess.TimeoutExpired:
        raise InputError(f"{file}: reading it takes more than {_SECONDS} s; save the table as CSV") from None
    if done.returncode < 0 or b"memory" in done.stderr.lower():
        raise InputError(
            f"{file}: its sheets take more than {2 * MAX_UNPACKED >> 20} MB of memory, which are allowed; "
            "save the table as CSV"
        )
    sizes = [[int(part) for part in line.split()] for line in done.stdout.decode().splitlines()]
    cells = sum((row + 1) * (column + 1) for row, column in sizes)  # the last of each, from 0
    if cells > MAX_SHEET_CELLS:
        raise InputError(
            f"{file}: its sheets span {cells} cells; allowed are {MAX_SHEET_CELLS}. Delete what stands far away, or "
            "save the table as CSV"
        )
