"""CasADi functions of one pose, called for many."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np


def function(name: str, inputs: Sequence[ca.SX], outputs: Sequence[ca.SX]) -> ca.Function:
    """Common subexpressions are computed once; outputs are dense."""
    return ca.Function(name, list(inputs), ca.cse([ca.densify(ca.SX(o)) for o in outputs]))


def call(one_pose: ca.Function | None, *inputs: np.ndarray) -> list[np.ndarray]:
    """A function of one pose at n poses: inputs and outputs are (n, ..), matrices in columns."""
    assert one_pose is not None
    n = len(inputs[0])
    outputs = [np.zeros((n, one_pose.numel_out(k))) for k in range(one_pose.n_out())]
    if n:
        buffer, run = one_pose.map(n).buffer()
        values = [np.ascontiguousarray(np.reshape(i, (n, -1)), dtype=float) for i in inputs]
        for k, value in enumerate(values):
            buffer.set_arg(k, memoryview(value))  # pyright: ignore
        for k, value in enumerate(outputs):
            buffer.set_res(k, memoryview(value))  # pyright: ignore
        run()
    return outputs
