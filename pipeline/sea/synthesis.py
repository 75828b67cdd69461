"""Ship motion in a seaway, as a sum of harmonic responses."""

from __future__ import annotations

import numpy as np

from kincal.pipeline.sea.closed_form import ClosedFormRao
from kincal.pipeline.sea.rao import Rao
from kincal.pipeline.sea.rao_files import read_rao
from kincal.pipeline.sea.settings import Seaway
from kincal.pipeline.sea.ship_motion import ShipMotion
from kincal.pipeline.sea.waves import drawn, spectrum
from kincal.urdf.errors import InputError

_COVERED = 0.95  # of the waves' energy, at least, by a table of responses


def rao_of(sea: Seaway) -> Rao:
    """The table of `sea.rao`, else the closed forms of `sea.vessel`.

    Raises InputError for a file that is no table, or one of other frequencies than the sea's.
    """
    if sea.rao is None:
        return ClosedFormRao(sea.vessel)
    table = read_rao(sea.rao, sea.speed)
    frequency, density = spectrum(sea)
    low, high = table.frequency[[0, -1]]
    share = density[(frequency >= low) & (frequency <= high)].sum() / density.sum()
    if share < _COVERED:
        raise InputError(
            f"{sea.rao}: frequencies {low:.3g} to {high:.3g} rad/s have {share:.0%} of the energy of waves with a peak "
            f"period of {sea.peak_period:g} s; allowed is at least {_COVERED:.0%}"
        )
    return table


def generated(sea: Seaway, rao: Rao) -> ShipMotion:
    """A record of `minutes` at `rate_hz`, by the sea's seed; derivatives are those of the harmonics, exact."""
    waves = drawn(sea)
    response = rao.response(waves.frequency, waves.direction, sea.speed)
    harmonics = response * (waves.amplitude * np.exp(1j * waves.phase))[:, None]
    turn = 1j * waves.encounter[:, None]
    t = np.arange(round(sea.minutes * 60 * sea.rate_hz)) / sea.rate_hz
    sums = superposed(waves.encounter, np.concatenate([harmonics, turn * harmonics, turn**2 * harmonics], axis=1), t)
    value, rate, second = np.split(sums, 3, axis=1)
    return ShipMotion(t, value[:, :3], rate[:, :3], second[:, :3], value[:, 3:], rate[:, 3:], second[:, 3:])


def superposed(frequency: np.ndarray, harmonics: np.ndarray, t: np.ndarray) -> np.ndarray:
    """(m, k): Re sum_i harmonics[i] exp(i frequency[i] t), harmonics (n, k), at evenly spaced times t (m,) from 0.

    exp(i w (t0 + s)) = exp(i w t0) exp(i w s): with blocks of sqrt(m) samples that begin at t0, all of it is one matrix
    product of few exponentials.
    """
    m, k = len(t), harmonics.shape[1]
    block = int(np.ceil(np.sqrt(m)))
    within = np.exp(1j * np.outer(frequency, t[:block]))  # (n, block)
    real_within = np.concatenate([np.real(within), -np.imag(within)])
    sums = np.empty((-(-m // block), block, k))
    for row, start in enumerate(t[::block]):
        turned = harmonics * np.exp(1j * frequency * start)[:, None]
        sums[row] = real_within.T @ np.concatenate([np.real(turned), np.imag(turned)])
    return sums.reshape(-1, k)[:m]
