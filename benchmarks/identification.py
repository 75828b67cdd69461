"""One identification of all parameters, against scipy's least squares with finite differences on the same residuals."""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares

from benchmarks.setup import measured_robot
from benchmarks.timing import median_seconds, row
from identification.estimators import identify, register


def main() -> None:
    for name in ("ups3_s", "jugglebot", "ur10"):
        errors, measured = measured_robot(name, 150)
        ours = identify(errors, measured)
        row(
            f"identification, 150 poses, {len(errors.parameters)} parameters ({name})",
            median_seconds(lambda e=errors, m=measured: identify(e, m)),
            f"cost {ours.cost:.6f} in {ours.iterations} iterations",
        )
        if name == "ups3_s":
            cost, seconds = _peer(errors, measured)
            row("  peer: scipy.optimize.least_squares, finite differences", seconds, f"cost {cost:.6f}")


def _peer(errors, measured) -> tuple[float, float]:
    """Same residuals, same batched loop closure, same start: what is left is derivatives and linear algebra."""
    start = register(errors, measured)
    tolerance = errors.parameters.tolerance

    def residuals(p: np.ndarray) -> np.ndarray:
        robot = errors.robot(p)
        closure = robot.close(measured.readings, start.q)
        return np.concatenate([errors.residual(robot, closure.q, measured).ravel(), p / tolerance])

    scale = np.where(np.isfinite(tolerance), tolerance, 1e-2)
    found = []
    seconds = median_seconds(
        lambda: found.append(least_squares(residuals, start.p, x_scale=scale, method="trf")), runs=1
    )
    return found[-1].cost, seconds


if __name__ == "__main__":
    main()
