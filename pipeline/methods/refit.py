"""A method on another day: the instrument was set up anew (W), the robot was homed anew (the actuators' zeros)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from kincal.identification.error_model import pose_residual
from kincal.identification.measurements import Measurements
from kincal.identification.registration import MIN_POSES, instrument_starts
from kincal.pipeline.methods.predictors import Method
from kincal.urdf.errors import InputError, NotConvergedError
from kincal.urdf.rigid_motion import Motion


@dataclass(frozen=True)
class Moved:
    """A method whose instrument and zeros have moved: a new zero is a shift of the readings that it knows."""

    method: Method
    instrument: Motion  # what comes before the method's own W
    shift: np.ndarray  # (n_actuated,) of the readings

    def predict(self, readings: np.ndarray) -> Motion:
        return self.instrument @ self.method.predict(readings + self.shift)


def refitted(method: Method, measured: Measurements, register: bool, rehome: bool) -> Moved:
    """`method` with W (register) and the zeros (rehome) fitted to measured poses, by its own predictions.

    The few unknowns are found from a closed-form start with differences of predictions: networks and models alike.
    Raises InputError for too few poses, NotConvergedError where the fit does not converge.
    """
    if len(measured) < MIN_POSES:
        raise InputError(f"{len(measured)} poses can't register an instrument; at least {MIN_POSES} are needed")
    n = measured.readings.shape[1]
    predicted = method.predict(measured.readings)
    starts = instrument_starts(predicted, measured) if register else [Motion.identity()]
    # the readings' own units may be anything: a shift counts in the range that was measured
    unit = np.maximum(np.ptp(measured.readings, axis=0), 1e-6)

    def moved(x: np.ndarray, start: Motion) -> Moved:
        turn = Motion.from_vector(x[:6]) @ start if register else start
        return Moved(method, turn, 1e-2 * unit * x[6 * register :] if rehome else np.zeros(n))

    def fit(start: Motion):
        def residuals(x: np.ndarray) -> np.ndarray:
            return pose_residual(moved(x, start).predict(measured.readings), measured).ravel()

        solution = least_squares(residuals, np.zeros(6 * register + n * rehome), method="trf", x_scale=1e-2, xtol=1e-12)
        return solution, moved(solution.x, start)

    solution, best = min((fit(start) for start in starts), key=lambda pair: pair[0].cost)
    if not solution.success:
        raise NotConvergedError(f"the fit of W and the zeros did not converge: {solution.message}")
    return best
