"""What the filter learns of the sea and of its own noise while it runs, by exponential forgetting.

The waves' period and size come from the moments of the acceleration and the velocity that the filter sees. The width
of their band (damping) follows the innovations, until their normalised squares have the mean that they should have
(covariance matching: Mehra 1972, IEEE Trans. Automatic Control 17): a wider band of the same size is less predictable,
while noise scaled by itself would take waves for tilt. Where nothing moves, the measurement's noise is scaled. Without
a gyro nothing is learned of the waves: what is swing and what acceleration, only the settings tell.
"""

from __future__ import annotations

import numpy as np

from kincal.identification.attitude import wave_band
from kincal.identification.attitude.motion import Layout, Nominal, Sea
from kincal.identification.attitude.settings import AttitudeSettings

_EVERY_S = 2.0  # between two changes of the model
_SETTLE_S = 20.0  # before anything is learned: the start's error is no wave
_FIRST_S = 5.0  # of learning that the settings are worth
_PERIOD_S = (3.0, 30.0)
_LEAST = 1e-3  # acceleration of waves [m/s2]
_DAMPING = (0.1, 0.8)
_NOISE = (0.25, 1e4)
_BY_DAMPING, _BY_SIZE = 0.65, 0.37  # powers by which the innovations' variance grows, in a moderate sea


class Adaptation:
    """`sea` is what to believe of the waves now (None without any), `noise` scales the measurement's variance."""

    def __init__(self, settings: AttitudeSettings) -> None:
        waves = settings.waves
        self.settings, self.elapsed, self.since, self.noise = settings, 0.0, 0.0, 1.0
        self.needed = 1.0  # innovations' mean square, had the model stayed as it was at first
        self.sea, self.moments = None, np.zeros(2)
        if waves is not None:
            self.sea = Sea(waves.period_s, waves.acceleration, waves.damping)
            velocity = waves.period_s / (2 * np.pi * wave_band.acceleration_by_velocity(waves.damping))
            self.moments = waves.acceleration**2 * np.array([1.0, velocity**2])

    def learn(
        self, dt: float, nominal: Nominal, covariance: np.ndarray, layout: Layout, normalised: np.ndarray
    ) -> None:
        """From one block of dt [s]: the state after its update, and its normalised innovation (2,)."""
        waves = self.settings.waves
        self.elapsed, self.since = self.elapsed + dt, self.since + dt
        if self.elapsed < _SETTLE_S or not (waves is None or (waves.adaptive and layout.gyro)):
            return
        # at first a plain mean over what has come, later forgetting
        share = max(1 - np.exp(-dt / self.settings.adapt_s), dt / (_FIRST_S + self.elapsed - _SETTLE_S))
        now = (
            self.noise
            if self.sea is None or waves is None
            else (self.sea.damping / waves.damping) ** _BY_DAMPING
            * (self.sea.acceleration / waves.acceleration) ** _BY_SIZE
        )
        self.needed += share * (now * float(normalised @ normalised) / 2 - self.needed)
        if waves is not None:
            x, y = nominal.wave**2 + covariance.diagonal()[layout.band].reshape(2, -1)
            self.moments += share * ((x + y)[wave_band.ACCELERATION : 0 : -1] / 2 - self.moments)
        if self.since < _EVERY_S:
            return
        self.since = 0.0
        if waves is None:
            self.noise = float(np.clip(self.needed, *_NOISE))
        else:
            acceleration = max(float(np.sqrt(self.moments[0])), _LEAST)
            smaller = (waves.acceleration / acceleration) ** _BY_SIZE
            damping = float(np.clip(waves.damping * (self.needed * smaller) ** (1 / _BY_DAMPING), *_DAMPING))
            ratio = 2 * np.pi * wave_band.acceleration_by_velocity(damping)
            period = float(np.clip(ratio * np.sqrt(self.moments[1] / self.moments[0]), *_PERIOD_S))
            self.sea = Sea(period, acceleration, damping)
