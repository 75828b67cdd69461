"""What the filter learns of the sea and of its own noise while it runs, by exponential forgetting.

The waves' period and size come from the moments of the acceleration and the velocity that the filter sees; the drive
scales the noise that is known least (of the waves, or of the measurement where there are none) until the normalised
innovations have the mean that they should have (covariance matching: Mehra 1972, IEEE Trans. Automatic Control 17).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from identification.attitude import wave_band
from identification.attitude.motion import Layout, Nominal, Sea
from identification.attitude.settings import AttitudeSettings

_EVERY_S = 2.0  # between two changes of the model
_PERIOD_S = (3.0, 30.0)
_LEAST = 1e-3  # acceleration of waves [m/s2]
_DRIVE = (1e-4, 1e4)
_SETTLE_S = 20.0  # before anything is learned: the start's error is no wave


class Adaptation:
    """`sea` is what to believe now."""

    def __init__(self, settings: AttitudeSettings) -> None:
        waves = settings.waves
        self.settings, self.elapsed, self.since = settings, 0.0, 0.0
        self.sea = Sea(8.0, 0.0) if waves is None else Sea(waves.period_s, waves.acceleration)
        self.nis = 1.0
        self.moments = np.zeros(2)
        if waves is not None:
            self.ratio = wave_band.peak_ratio(waves.damping) * 2 * np.pi
            self.moments = waves.acceleration**2 * np.array([1.0, (waves.period_s / self.ratio) ** 2])

    def learn(self, dt: float, nominal: Nominal, covariance: np.ndarray, layout: Layout, normalised: np.ndarray) -> None:
        """From one block of dt [s]: the state after its update, and its normalised innovation (2,)."""
        if self.settings.waves is not None and not self.settings.waves.adaptive:
            return
        self.elapsed, self.since = self.elapsed + dt, self.since + dt
        if self.elapsed < _SETTLE_S:
            return
        share = 1 - np.exp(-dt / self.settings.adapt_s)
        self.nis += share * (float(normalised @ normalised) / len(normalised) - self.nis)
        if self.settings.waves is not None:
            variance = np.diag(covariance)[layout.band].reshape(2, 4)
            seen = np.mean(nominal.wave**2 + variance, axis=0)[[wave_band.ACCELERATION, wave_band.ACCELERATION - 1]]
            self.moments = self.moments + share * (seen - self.moments)
        if self.since >= _EVERY_S:
            self.since = 0.0
            drive = float(np.clip(self.sea.drive * self.nis ** 0.1, *_DRIVE))
            self.sea = replace(self.sea, drive=drive)
            if self.settings.waves is not None:
                period = float(np.clip(self.ratio * np.sqrt(self.moments[1] / self.moments[0]), *_PERIOD_S))
                acceleration = max(float(np.sqrt(self.moments[0])), _LEAST)
                self.sea = Sea(period, acceleration, drive)
