"""What becomes of a computation for which there is not enough memory: one line."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from kincal.urdf.errors import OUT_OF_MEMORY, CalibrationError

_SAID_BY_LIBRARIES = ("can't allocate memory", "bad_alloc")  # torch and casadi raise a RuntimeError


@contextmanager
def within_memory(name: str) -> Iterator[None]:
    """Where memory runs out: CalibrationError, which begins with `name`."""
    try:
        yield
    except MemoryError:
        raise CalibrationError(f"{name}: {OUT_OF_MEMORY}") from None
    except RuntimeError as error:
        if isinstance(error, CalibrationError) or not any(text in str(error) for text in _SAID_BY_LIBRARIES):
            raise
        raise CalibrationError(f"{name}: {OUT_OF_MEMORY}") from None
