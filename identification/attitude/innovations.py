"""Do the innovations fit the filter? Normalised innovation squared, its band, and the whiteness of what is left.

Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation (2001), section 5.4.2.
"""

from __future__ import annotations

import numpy as np
from scipy.special import chdtri

from kincal.identification.attitude.settings import InnovationStatistics

_LAGS = 20
_FEWEST = 100  # updates: fewer say nothing
_NORMAL = 1.959964


def statistics(channel: str, normalised: np.ndarray, gated: np.ndarray) -> InnovationStatistics:
    """normalised: (n, k) innovations in units of their sigma; gated: (n,) those that were refused."""
    n, k = normalised.shape
    good = normalised[~gated]
    squared = (good**2).sum(axis=1)
    if len(good) < _FEWEST:
        nan = float("nan")
        message = f"{channel}: {len(good)} good updates of {n} are too few to judge the filter by; {_FEWEST} would do"
        return InnovationStatistics(channel, n, int(gated.sum()), nan, (nan, nan), nan, nan, nan, nan, message)
    mean = float(squared.mean()) / k
    effective = len(good) / max(1.0, 1 + 2 * float(np.sum(_autocorrelation(squared - squared.mean()).clip(0))))
    together = np.corrcoef(good.T).reshape(k, k)  # long-crested waves push along one line
    effective *= k / float(np.sum(together**2))
    half = _NORMAL * float(np.sqrt(2 / (k * effective)))
    lags = np.mean([_autocorrelation(column) for column in good.T], axis=0)
    white = float(np.mean(np.abs(lags) <= _NORMAL / np.sqrt(len(good) * k)))
    inside = float(np.mean(squared <= chdtri(k, 0.05)))
    by_channel = []
    if not 1 - half <= mean <= 1 + half:
        by_channel.append(
            f"their mean square is {mean:.2f} (95 % of means lie within {1 - half:.2f} and {1 + half:.2f})"
        )
    if lags[0] > 0.5:
        by_channel.append(f"they repeat themselves (autocorrelation {lags[0]:.2f})")
    if gated.mean() > 0.05:
        by_channel.append(f"{gated.mean():.0%} were refused as outliers")
    warning = f"{channel}: the innovations don't fit the filter: {'; '.join(by_channel)}" if by_channel else None
    return InnovationStatistics(
        channel, n, int(gated.sum()), mean, (1 - half, 1 + half), effective, inside, float(lags[0]), white, warning
    )


def _autocorrelation(values: np.ndarray) -> np.ndarray:
    """(20,) at lags 1 to 20, of values (n,) about zero."""
    power = float(values @ values)
    return np.array([values[lag:] @ values[:-lag] / power for lag in range(1, _LAGS + 1)])
