"""One case: spoiled files, read within limits of time and memory, and what came of it."""

from __future__ import annotations

import os
import shutil
import signal
import time
import traceback
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from kincal.urdf.errors import CalibrationError, InputError
from tests.fuzz.seeds import Files
from tests.fuzz.targets import Target

MEGABYTES = 1500.0  # that a case may add to what the process has
LETTERS = 2000  # of a message
ROOT = Path(__file__).parents[2]


class TooSlow(BaseException):
    """No Exception: nobody catches it."""


@dataclass(frozen=True)
class Result:
    target: str
    number: int
    outcome: str  # accepted, refused, defect
    said: str
    seconds: float  # of computing
    megabytes: float


def run(target: Target, number: int, root: Path, files: Files | None = None) -> Result:
    """Read a case's files in a folder of its own below `root`."""
    files = target.case(number) if files is None else files
    folder, cwd = root / "case", root / "cwd"
    for place in (folder, cwd):
        shutil.rmtree(place, ignore_errors=True)
        place.mkdir(parents=True)
    for name, content in files.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(content)
    os.chdir(cwd)
    before = _memory(reset=True)
    silent = _said(root)
    began = time.process_time()
    outcome, said = _read(target, folder)
    seconds = time.process_time() - began
    megabytes = max(_memory() - before, 0.0)
    if outcome != "defect":
        written = {str(f.relative_to(folder)): f.read_bytes() for f in folder.rglob("*") if f.is_file()}
        if written != files or any(cwd.iterdir()):
            outcome, said = "defect", "something was written"
        elif _said(root) != silent:
            outcome, said = "defect", "printed: " + (root / "printed").read_text(errors="replace")[silent:][:300]
        elif megabytes > MEGABYTES:
            outcome, said = "defect", f"{megabytes:.0f} MB"
        elif number == 0 and outcome != "accepted":
            outcome, said = "defect", f"valid files are refused: {said}"
    return Result(target.name, number, outcome, said, seconds, megabytes)


def _read(target: Target, folder: Path) -> tuple[str, str]:
    try:
        with _limited(target.seconds), warnings.catch_warnings():
            warnings.simplefilter("error")
            target.read(folder)
        return "accepted", ""
    except (InputError, CalibrationError) as error:
        said = str(error)
        if not any(word in said for word in target.words()):
            return "defect", f"names no file: {said[:300]}"
        if len(said.replace(str(folder), "")) > LETTERS:
            return "defect", f"a message of {len(said)} letters: {said[-200:]!r}"
        return "refused", said
    except TooSlow as error:
        return "defect", f"longer than {target.seconds:g} s at {_where(error)}"
    except BaseException as error:
        return "defect", f"{type(error).__name__} at {_where(error)}: {str(error)[:200]}"


def _where(error: BaseException) -> str:
    """The innermost line of kincal's own."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [
        f
        for f in frames
        if f.filename.startswith(str(ROOT)) and "/tests/" not in f.filename and "/.venv/" not in f.filename
    ]
    frame = (own or frames)[-1]
    return f"{Path(frame.filename).name}:{frame.lineno} {frame.name}"


@contextmanager
def _limited(seconds: float) -> Iterator[None]:
    """Of computing: who waits for something is noticed from outside, since a busy machine makes all wait."""

    def stop(*_: object) -> None:
        raise TooSlow

    previous = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, previous)


def _said(root: Path) -> int:
    """Bytes that were printed so far: a worker's stdout and stderr go to a file."""
    file = root / "printed"
    return file.stat().st_size if file.exists() else 0


def _memory(reset: bool = False) -> float:
    """[MB] the largest since it was reset, where the system tells that."""
    try:
        if reset:
            Path("/proc/self/clear_refs").write_text("5")
        status = Path("/proc/self/status").read_text()
    except OSError:
        return 0.0
    return next(float(line.split()[1]) / 1024 for line in status.splitlines() if line.startswith("VmHWM"))


def shrunk(target: Target, result: Result, root: Path, seconds: float = 20.0) -> Files:
    """The case's files with as much cut away from those that were spoiled as leaves the same defect."""
    files, end = target.case(result.number), time.monotonic() + seconds
    kind = result.said[:40]
    for name in files:
        step = len(files[name]) // 2
        while step and time.monotonic() < end:
            begin = 0
            while begin < len(files[name]) and time.monotonic() < end:
                tried = files | {name: files[name][:begin] + files[name][begin + step :]}
                again = run(target, result.number, root, tried)
                if again.outcome == "defect" and again.said[:40] == kind:
                    files = tried
                else:
                    begin += step
            step //= 2
    return files
