"""Does identification recover robots as well as measurements allow? Virtual robots, geometric errors and noise alone.

Chi-square over its degrees of freedom (rows less the effective number of parameters): 1 where residuals are as large as
they should be. Error over bound: root mean square error of predicted poses on fresh configurations over the Bayesian
Cramer-Rao bound, the covariance (J'J + P)^-1 at the true parameters propagated to these poses; 1 is the least possible.
For tilt alone the error is that of the vertical.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass

import numpy as np
import scipy.linalg

from benchmarks.setup import Bench, bench, spread
from kincal.identification.accuracy import gravity_error, orientation_error
from kincal.identification.error_model import BuiltRobot
from kincal.identification.estimators import estimate_parameters
from kincal.identification.expected import Sites
from kincal.identification.measurements import Measurements
from kincal.urdf.errors import CalibrationError, InputError

COUNTS = (10, 20, 50, 150)
FRESH = 100
_FLAT = 10.0  # sigma that stands for W's and T's flat priors [m, rad]
CASES = {
    "ups3_s": ("ups3_s", None),
    "ups3_s, orientation": ("ups3_s", ("orientation",)),
    "ups2_u": ("ups2_u", None),
    "rps3": ("rps3", None),
    "linear_delta": ("linear_delta", None),
    "gough_stewart": ("gough_stewart", None),
    "jugglebot": ("jugglebot", None),
    "ur10": ("ur10", None),
}


@dataclass(frozen=True)
class Fit:
    """One robot, identified; sums of squares are over fresh poses, None where that is not measured."""

    chi_square: float
    freedom: float
    turned: tuple[float, float] | None  # squared error and its bound [rad^2]
    moved: tuple[float, float] | None  # [m^2]
    seconds: float
    iterations: int


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", nargs="*", metavar="CASE", help=f"of {', '.join(CASES)}; default: all")
    parser.add_argument("--robots", type=int, default=100, help="virtual robots a row (100)")
    parser.add_argument("--poses", type=int, nargs="+", default=COUNTS, help="10 20 50 150")
    options = parser.parse_args()
    print(
        f"{options.robots} robots a row; chi-square per degree of freedom and error over bound, +- one standard error"
    )
    print(
        f"{'robot: measured':<36}{'poses':>6}{'chi-square':>17}{'rotation':>17}{'position':>17}"
        f"{'iterations':>11}{'s a fit':>9}{'failures':>9}",
        flush=True,
    )
    for case in options.cases or CASES:
        for n in options.poses:
            found = list(spread(one, [(case, n, seed) for seed in range(options.robots)]))
            fits = [fit for fit in found if isinstance(fit, Fit)]
            print(_row(case, n, fits, len(found) - len(fits)), flush=True)
            for seed, failure in enumerate(found):
                if isinstance(failure, str):
                    print(f"    robot {seed}: {failure}", flush=True)


def one(job: tuple[str, int, int]) -> Fit | str:
    """Virtual robot `seed`, identified from n poses; or why it could not be."""
    case, n, seed = job
    at = bench(*CASES[case])
    truth, robot = at.built(seed)
    sites = at.sites(n, [seed, 21])
    measured = at.measured(robot, sites.readings, seed)
    began = time.perf_counter()
    try:
        found = estimate_parameters(at.model, measured)
    except (CalibrationError, InputError) as error:
        return f"{type(error).__name__}: {error}"
    seconds = time.perf_counter() - began
    fresh = at.sites(FRESH, [seed, 22])
    errors = _errors(at, robot, at.model.robot(found.p), fresh)
    bounds = _bounds(at, truth, robot, measured, fresh)
    turned, moved = (None if e is None else (float(np.sum(e**2)), b) for e, b in zip(errors, bounds, strict=True))
    chi_square = float(np.sum(found.residual**2))
    return Fit(chi_square, measured.rows - found.effective, turned, moved, seconds, found.iterations)


def _errors(at: Bench, robot: BuiltRobot, identified: BuiltRobot, fresh: Sites) -> tuple[np.ndarray | None, ...]:
    """(m, 3) errors of rotation [rad] and position [m] at fresh poses, where they are measured."""
    actual, predicted = (
        built.measured(built.close(fresh.readings).require(lambda row: f"fresh pose {row}").pose)
        for built in (robot, identified)
    )
    turned = None
    if _turns(at):
        error = gravity_error if at.channels == ("tilt",) else orientation_error
        turned = error(actual.rotation, predicted.rotation)
    return turned, predicted.translation - actual.translation if "position" in at.channels else None


def _bounds(
    at: Bench, truth: np.ndarray, robot: BuiltRobot, measured: Measurements, fresh: Sites
) -> tuple[float | None, float | None]:
    """The least expected sums of squares of the same."""
    parameters, n = at.model.parameters, len(truth)
    sigma = np.where(parameters.flat, _FLAT, parameters.tolerance)
    jacobian = at.model.jacobian(truth, measured) * sigma
    factor = np.linalg.qr(np.concatenate([np.eye(n), jacobian.reshape(-1, n)]), mode="r")
    closure = robot.close(fresh.readings)
    rates = at.model.pose_jacobian(truth, fresh.readings, closure.q) * sigma
    turned = rates[:, :3]
    if at.channels == ("tilt",):
        up = robot.measured(closure.pose).rotation[:, 2]
        turned = turned - up[:, :, None] * np.einsum("ni,nij->nj", up, turned)[:, None]

    def size(rates: np.ndarray) -> float:
        half = scipy.linalg.solve_triangular(factor.T, rates.reshape(-1, n).T, lower=True)
        return float(np.sum(half**2))

    return size(turned) if _turns(at) else None, size(rates[:, 3:]) if "position" in at.channels else None


def _turns(at: Bench) -> bool:
    return "orientation" in at.channels or "tilt" in at.channels


def _row(case: str, n: int, fits: list[Fit], failures: int) -> str:
    chi_square = _ratio([(fit.chi_square, fit.freedom) for fit in fits])
    cells = [f"{chi_square[0]:9.4f} +-{chi_square[1]:6.4f}"]
    for name in ("turned", "moved"):
        pairs = [pair for fit in fits if (pair := getattr(fit, name)) is not None]
        if pairs:
            square, error = _ratio(pairs)
            cells.append(f"{np.sqrt(square):9.3f} +-{error / (2 * np.sqrt(square)):6.3f}")
        else:
            cells.append("-")
    seconds, iterations = (np.median([getattr(fit, name) for fit in fits]) for name in ("seconds", "iterations"))
    name = f"{case.split(',')[0]}: {' and '.join(bench(*CASES[case]).channels)}"
    return f"{name:<36}{n:>6}{''.join(f'{c:>17}' for c in cells)}{iterations:>11.0f}{seconds:>9.3f}{failures:>9}"


def _ratio(pairs: list[tuple[float, float]]) -> tuple[float, float]:
    """The ratio of sums, and its standard error over robots (delta method)."""
    first, second = np.array(pairs).T
    ratio = first.sum() / second.sum()
    return float(ratio), float(np.sqrt(np.sum((first - ratio * second) ** 2)) / second.sum())


if __name__ == "__main__":
    main()
