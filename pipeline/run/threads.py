"""How many threads the numerical libraries use while a stage runs: the last bits of a sum depend on it."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterator
from contextlib import contextmanager, nullcontext

THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


@contextmanager
def fixed_threads(libraries: Collection[str]) -> Iterator[None]:
    """One thread within, or as many as OPENBLAS_NUM_THREADS and OMP_NUM_THREADS say; afterwards as before.

    Where the environment fixes the number, as the command line sees to, the libraries obey it by themselves.
    libraries: those that will be used. A library that is imported within would miss the limit, so it is imported here.
    """
    if all(name in os.environ for name in THREADS):
        yield
        return
    from threadpoolctl import threadpool_limits

    blas, openmp = map(_given, THREADS[:2])
    import scipy.linalg  # noqa: F401

    of_torch = _torch_threads(openmp) if "torch" in libraries else nullcontext()
    with of_torch, threadpool_limits({"blas": blas, "openmp": openmp}):
        yield


def _given(name: str) -> int:
    """The number that the environment gives; 1 where it gives none."""
    text = os.environ.get(name, "1")
    return max(1, int(text)) if text.isascii() and text.isdigit() else 1


@contextmanager
def _torch_threads(threads: int) -> Iterator[None]:
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    try:
        yield
    finally:
        torch.set_num_threads(before)
