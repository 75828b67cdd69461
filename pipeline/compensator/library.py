"""A compensator's C, compiled and called from here: to be checked before it is handed out, and in tests."""

from __future__ import annotations

import ctypes
import subprocess
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from kincal.identification.compiled import build
from kincal.identification.measurements import quaternions
from kincal.urdf.errors import CalibrationError
from kincal.urdf.rigid_motion import Motion

NOT_CONVERGED, OTHER_BRANCH, BEYOND_LIMITS, OUTSIDE_WORKSPACE = 1, 2, 4, 8  # what its functions return, summed
_OPTIONS = ("-O0", "-std=c99", "-shared", "-fPIC")  # compiled sooner than it takes to run it a few hundred times


class _Status(ctypes.Structure):
    _fields_ = (("iterations", ctypes.c_int), ("error", ctypes.c_double), ("share", ctypes.c_double))


@dataclass(frozen=True)
class Answers:
    """What n calls returned. Rows that were not written are NaN."""

    values: np.ndarray  # (n, ..) readings; or positions and quaternions
    flags: np.ndarray  # (n,)
    iterations: np.ndarray  # (n,)
    error: np.ndarray  # (n,)
    share: np.ndarray  # (n,)

    @property
    def found(self) -> np.ndarray:
        """(n,) whether the call wrote anything."""
        return self.flags & (NOT_CONVERGED | OTHER_BRANCH) == 0


@dataclass(frozen=True)
class Library:
    """The compiled functions of the code called `name`, for a robot with so many actuators, joints and passive ones."""

    handle: ctypes.CDLL
    name: str
    counts: tuple[int, int, int]

    @staticmethod
    def of(files: Mapping[str, str], name: str, counts: tuple[int, int, int], compiler: str, folder: Path) -> Library:
        """Compiles `files` in `folder`. Raises CalibrationError where the compiler refuses them."""
        for file, text in files.items():
            (folder / file).write_text(text, encoding="utf-8")
        built = folder / f"{name}.so"
        try:
            build(compiler, [folder / f"{name}.c"], built, *_OPTIONS)
            build(compiler, [folder / f"{name}_main.c", built], folder / name, f"-Wl,-rpath,{folder}", "-std=c99")
            return Library(ctypes.CDLL(str(built)), name, counts)
        except (OSError, subprocess.SubprocessError) as error:
            message = getattr(error, "stderr", b"") or str(error).encode()
            first = message.decode(errors="replace").strip().splitlines()[:1]
            raise CalibrationError(
                f"--format c: {compiler} refuses the code ({''.join(first)}); nothing was exported"
            ) from None

    def commands(self, desired: Motion, warm: bool = False) -> Answers:
        """Readings for desired poses (n), each searched from home; warm: from where the one before was found."""
        actuators, joints, passive = self.counts
        state = np.zeros(joints + max(passive, 1))
        start, command = self._function("start"), self._function("command")
        start(_at(state))

        def call(row: int, answer: np.ndarray, status: _Status) -> int:
            if not warm:
                start(_at(state))
            return command(_at(position[row]), _at(quaternion[row]), _at(state), _at(answer), ctypes.byref(status))

        position, quaternion = np.ascontiguousarray(desired.translation), quaternions(desired.rotation)
        return _each(call, len(position), actuators)

    def predictions(self, readings: np.ndarray) -> Answers:
        """Positions and quaternions (n, 7) at readings (n, n_actuated)."""
        predict, readings = self._function("predict"), np.ascontiguousarray(readings)

        def call(row: int, answer: np.ndarray, status: _Status) -> int:
            return predict(_at(readings[row]), _at(answer), _at(answer[3:]), ctypes.byref(status))

        return _each(call, len(readings), 7)

    def _function(self, name: str) -> Any:
        return getattr(self.handle, f"{self.name}_{name}")


def _each(call: Callable[[int, np.ndarray, _Status], int], n: int, width: int) -> Answers:
    values, flags, status = np.full((n, width), np.nan), np.zeros(n, dtype=int), _Status()
    answers = np.zeros((n, 3))
    for row in range(n):
        flags[row] = call(row, values[row], status)
        answers[row] = status.iterations, status.error, status.share
    return Answers(values, flags, answers[:, 0].astype(int), answers[:, 1], answers[:, 2])


def _at(array: np.ndarray) -> Any:
    return array.ctypes.data_as(ctypes.POINTER(ctypes.c_double))
