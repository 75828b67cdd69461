"""The command `kincal`: its commands, and how it ends."""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Callable
from typing import Any

from cyclopts import App, CycloptsError
from rich.text import Text

from kincal.pipeline.commands.console import PipedConsole
from kincal.pipeline.interface.progress import err
from kincal.urdf.errors import OUT_OF_MEMORY, CalibrationError, InputError, of_system, one_line
from kincal.version import __version__

app = App(
    console=PipedConsole(),
    name="kincal",
    help="Calibrates closed-chain (parallel) robots from a handful of measured poses.",
    help_format="plaintext",
    version=__version__,
    version_flags=["--version"],
    suppress_keyboard_interrupt=False,  # main says so
)
# Each command's module is imported when the command is called, or its help is asked for.
_COMMANDS = {
    "calibration": ("run", "compare", "inspect", "status", "predict", "compensate", "evaluate"),
    "plan": ("init", "schema", "plan"),
    "columns": ("columns",),
    "export": ("export",),
    "studies": ("sweep", "reproduce"),
    "sea": ("sea_trial",),
}
for _module, _names in _COMMANDS.items():
    for _name in _names:
        app.command(f"kincal.pipeline.commands.{_module}:{_name}", name=_name.replace("_", "-"))
app.command("kincal.pipeline.commands.cache:app", name="cache")
for _name in ("gc", "accept", "verify"):  # as they were called once
    app.command(f"kincal.pipeline.commands.cache:moved_{_name}", name=_name, show=False)


class _Warnings(logging.Handler):
    """What the library warns of, on stderr."""

    def emit(self, record: logging.LogRecord) -> None:
        err.print(Text(f"warning: {one_line(record.getMessage())}", style="yellow"), soft_wrap=True)


def main(arguments: list[str] | None = None) -> None:
    """Run the command and exit: 0 done, 1 the calibration failed its own checks, 2 bad input."""
    given = sys.argv[1:] if arguments is None else arguments
    if not given or given[0] in ("--help", "-h"):  # the list of commands shows what each of them says of itself
        for name in (*(name for names in _COMMANDS.values() for name in names), "cache"):
            app[name.replace("_", "-")]
    warnings = _Warnings(logging.WARNING)
    logger = logging.getLogger("kincal")
    logger.addHandler(warnings)
    try:
        sys.exit(_status(lambda: app(arguments, exit_on_error=False, print_error=False)))
    finally:
        logger.removeHandler(warnings)


def _status(call: Callable[[], Any]) -> int:
    try:
        call()
        sys.stdout.flush()
    except CycloptsError as error:
        return _say(str(error).splitlines()[0], 2)
    except InputError as error:
        return _say(str(error), 2)
    except CalibrationError as error:
        return _say(str(error), 1)
    except KeyboardInterrupt:
        return _say("interrupted", 130)
    except MemoryError:
        return _say(OUT_OF_MEMORY, 1)
    except BrokenPipeError:
        sys.stderr.close()
        return 0
    except OSError as error:
        if error.filename is None:  # the output: what it has not taken is not written once more at the end
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return _say(of_system(error), 2)
    return 0


def _say(message: str, code: int) -> int:
    err.print(Text("kincal: " + one_line(message)), soft_wrap=True)
    return code
