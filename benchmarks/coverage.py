"""Do 95 % intervals hold the truth 95 times in 100? Virtual 3-UPS/S platforms, geometric errors and noise alone.

Pooled over the combinations of parameters that the data can tell (principal directions of the estimate's covariance
within the identifiable subspace, in tolerances), over all parameters whose sigma is finite, and over predicted fresh
poses: each component of the rotation vector; roll and pitch for tilt alone.
"""

from __future__ import annotations

import argparse

import numpy as np
import scipy.linalg
from scipy.special import ndtri

from benchmarks.setup import Bench, bench, spread
from kincal.identification.estimators import Estimate, estimate_parameters, register
from kincal.identification.expected import Sites, expected
from kincal.identification.identifiability import FLAT_SCALE, identifiability
from kincal.identification.measurements import Measurements
from kincal.urdf.description import Identify
from kincal.urdf.errors import CalibrationError, InputError

LOSSES = ("gaussian", "huber", "cauchy")
CHANNELS = (("orientation",), ("tilt",))
FRESH = 100
LIMIT = float(ndtri(0.975))
WHAT = ("combinations", "parameters", "poses")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", type=int, default=200, help="virtual robots a row (200)")
    parser.add_argument("--poses", type=int, default=40)
    parser.add_argument("--robot", default="ups3_s")
    options = parser.parse_args()
    print(f"{options.robot}, {options.poses} poses, {options.robots} robots a row: share of 95 % intervals that hold")
    print(f"{'measured':<14}{'loss':<10}{''.join(f'{what:>22}' for what in WHAT)}{'failures':>10}", flush=True)
    for channels in CHANNELS:
        for loss in LOSSES:
            jobs = [(options.robot, channels, loss, options.poses, seed) for seed in range(options.robots)]
            found = list(spread(one, jobs))
            held = np.array([f for f in found if not isinstance(f, str)])  # (robots, what, (held, all))
            cells = []
            for k in range(len(WHAT)):
                shares = held[:, k, 0] / held[:, k, 1]
                error = 100 * shares.std() / np.sqrt(len(shares))
                cells.append(f"{100 * held[:, k, 0].sum() / held[:, k, 1].sum():10.2f} % +-{error:5.2f}")
            failures = len(found) - len(held)
            print(f"{channels[0]:<14}{loss:<10}{''.join(f'{c:>22}' for c in cells)}{failures:>10}", flush=True)
            for seed, failure in enumerate(found):
                if isinstance(failure, str):
                    print(f"    robot {seed}: {failure}", flush=True)


def one(job: tuple[str, tuple, str, int, int]) -> list[tuple[int, int]] | str:
    """Of virtual robot `seed`: how many intervals hold, of how many, for each of WHAT; or why it has none."""
    name, channels, loss, n, seed = job
    at = bench(name, channels)
    truth, robot = at.built(seed)
    measured = at.measured(robot, at.sites(n, [seed, 31]).readings, seed)
    try:
        registered = register(at.model, measured)
        found = estimate_parameters(at.model, measured, Identify(loss=loss), registered)
    except (CalibrationError, InputError) as error:
        return f"{type(error).__name__}: {error}"
    error = found.p - truth
    by_parameter = (np.abs(error) < LIMIT * np.sqrt(np.diag(found.covariance)))[~found.unseen]
    return [
        _counted(_combinations(at, measured, registered, found, error)),
        _counted(by_parameter),
        _counted(_poses(at, truth, found, at.sites(FRESH, [seed, 32]))),
    ]


def _combinations(
    at: Bench, measured: Measurements, registered: Estimate, found: Estimate, error: np.ndarray
) -> np.ndarray:
    parameters = at.model.parameters
    scale = np.where(parameters.flat, FLAT_SCALE, parameters.tolerance)
    seen = identifiability(registered.triangle[:, :-1], parameters, measured.rows)
    basis = scipy.linalg.null_space(seen.basis) if len(seen.basis) else np.eye(len(scale))
    variance, directions = np.linalg.eigh(basis.T @ (found.covariance / np.outer(scale, scale)) @ basis)
    return np.abs(directions.T @ (basis.T @ (error / scale))) < LIMIT * np.sqrt(variance)


def _poses(at: Bench, truth: np.ndarray, found: Estimate, fresh: Sites) -> np.ndarray:
    """Whether the true poses lie within the intervals of those predicted, by what was measured."""
    actual = expected(at.model, truth, fresh.readings, fresh.q, at.channels, at.sensor)
    identified = at.model.robot(found.p)
    q = identified.close(fresh.readings).q
    rates = at.model.jacobian(found.p, actual, q)
    variance = np.einsum("nij,jk,nik->ni", rates, found.covariance, rates)
    return np.abs(at.model.residual(identified, q, actual)) < LIMIT * np.sqrt(variance)


def _counted(held: np.ndarray) -> tuple[int, int]:
    return int(held.sum()), held.size


if __name__ == "__main__":
    main()
