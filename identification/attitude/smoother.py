"""The fixed-interval smoother: each attitude from all samples, before and after it. For stretches of calibration.

Rauch, Tung, Striebel, Maximum likelihood estimates of linear dynamic systems, AIAA Journal 3 (1965) 1445-1450, on the
errors: they are differences of nominal states, rotations by rotation vectors.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kincal.identification.attitude.blocks import Blocks
from kincal.identification.attitude.error_state import Step
from kincal.identification.attitude.estimate import Stretch, bias_free, estimate
from kincal.identification.attitude.filter import learning, steps, stretch
from kincal.identification.attitude.motion import Layout, Nominal
from kincal.identification.attitude.settings import AttitudeEstimate, AttitudeSettings, Samples, check


def smooth_attitude(
    t: np.ndarray, samples: Samples, settings: AttitudeSettings, source: str = "samples"
) -> AttitudeEstimate:
    """As `filter_attitude`, with the samples after each as well; the innovations are the filter's.

    Keeps some 20 kB a block (`update_s`) in memory: an hour of record is 300 MB. Raises InputError as the filter does.
    """
    check(t, samples, settings, source)
    chunks: list[Blocks] = []
    run: list[Step] = []
    starts: list[Nominal] = []
    for blocks, start, step in steps(t, samples, settings):
        if not chunks or blocks is not chunks[-1]:
            chunks.append(blocks)
        run.append(step)
        starts.append(start)
    layout = Layout.of(settings, samples.gyro is not None)
    stretches = smoothed(starts, run, layout, np.concatenate([b.dt for b in chunks]))
    return estimate(len(t), chunks, stretches, learning(len(stretches), settings))


def smoothed(starts: list[Nominal], run: list[Step], layout: Layout, dt: np.ndarray) -> list[Stretch]:
    """The run's stretches with smoothed ends, from the last to the first and back in order."""
    state, covariance = run[-1].nominal, run[-1].covariance
    ends, errors = [state], []
    covariances = [covariance]
    for step, after in zip(run[-2::-1], run[:0:-1], strict=True):
        gain = _gain(step.covariance, after.transition, after.predicted_covariance)
        error = after.predicted.errors(state, layout)
        errors.append(error[:3])
        state = step.nominal.corrected(gain @ error, layout)
        covariance = step.covariance + gain @ (covariance - after.predicted_covariance) @ gain.T
        ends.append(state)
        covariances.append(covariance)
    errors.append(run[0].predicted.errors(state, layout)[:3])
    before = [errors[-1] + _slid(starts[0], ends[-1], float(dt[0]), layout)]
    before += [step.nominal.errors(end, layout)[:3] for step, end in zip(run[:-1], ends[:0:-1], strict=True)]
    return [
        replace(
            stretch(start, step),
            end=end,
            covariance=p[:3, :3],
            bias_free=bias_free(p, step.tilt),
            correction=np.array([first, last]),
        )
        for start, step, end, p, first, last in zip(
            starts, run, ends[::-1], covariances[::-1], before, errors[::-1], strict=True
        )
    ]


def _gain(filtered: np.ndarray, transition: np.ndarray, predicted: np.ndarray) -> np.ndarray:
    """filtered transition^T predicted^-1, in units of sigma: displacements and biases are of very different size."""
    unit = np.sqrt(np.maximum(predicted.diagonal(), 1e-30))
    scaled = predicted / np.outer(unit, unit)
    return np.linalg.lstsq(scaled, (transition @ filtered) / unit[:, None], rcond=1e-13)[0].T / unit


def _slid(start: Nominal, end: Nominal, dt: float, layout: Layout) -> np.ndarray:
    """(3,) how the correction of the first block's start differs from that of its end: by the gyro's bias."""
    return dt * start.rotation @ (end.gyro_bias - start.gyro_bias) if layout.gyro else np.zeros(3)
