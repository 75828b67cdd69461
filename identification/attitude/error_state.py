"""The error-state Kalman filter (filterpy) behind attitude, one block of samples at a time.

filterpy's filter holds the errors of the nominal state: they are zero but between an update and the reset after it
(Sola, Quaternion kinematics for the error-state Kalman filter, 2017, section 6). Its measurement is the level force

    R (f - bias) - waves = [u]x d + R (error of the bias) + (error of the waves) + noise,    x and y of it

with u = R (f - bias). Yaw does not enter: the waves' axes are those of the yaw as it is estimated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.constants import g
from scipy.special import chdtri

from kincal.identification.attitude import wave_band
from kincal.identification.attitude.adaptation import Adaptation
from kincal.identification.attitude.blocks import Blocks
from kincal.identification.attitude.motion import Layout, Nominal, move, rotation_of, swing_model, wave_model
from kincal.identification.attitude.settings import AttitudeSettings
from kincal.urdf.errors import InputError
from kincal.urdf.rigid_motion import cross, from_zyx_angles, zyx_angles

_UNKNOWN_YAW = 2.0  # one sigma before the first heading [rad]
_FORGIVEN = 4  # refused updates in a row: after them the noise is taken as larger and larger


@dataclass(frozen=True)
class Update:
    """An innovation in units of its sigma, each component by itself; None where nothing came."""

    normalised: np.ndarray | None = None
    gated: bool = False


@dataclass(frozen=True)
class Step:
    """The filter at the end of a block. tilt: (2, size), the level force by attitude and bias."""

    nominal: Nominal
    covariance: np.ndarray
    tilt: np.ndarray
    turn: np.ndarray
    force: Update
    heading: Update
    transition: np.ndarray  # into this step
    predicted: Nominal  # before the update
    predicted_covariance: np.ndarray


class ErrorStateFilter:
    """What it is now: `nominal`, and filterpy's covariance. One call of `advance` a block."""

    def __init__(self, settings: AttitudeSettings, gyro: bool, heading: bool, first: Blocks) -> None:
        """first: the blocks of the start, whose median force tells the first tilt."""
        from filterpy.kalman import ExtendedKalmanFilter  # imports matplotlib: a second

        self.settings, self.layout = settings, Layout.of(settings, gyro)
        self.adaptation = Adaptation(settings)
        yaw = first.heading[np.isfinite(first.heading)]
        self.nominal = Nominal(
            start_rotation(first, float(yaw[0]) if len(yaw) else 0.0),
            np.zeros(3),
            np.zeros((2, 3)),
            np.zeros(3),
            np.zeros((2, wave_band.ORDER)),
        )
        self.elapsed, self.mean_tilt = 0.0, np.zeros(2)  # [s]; pitch, roll [rad]
        self.ekf = ExtendedKalmanFilter(dim_x=self.layout.size, dim_z=2)
        self.ekf.x = np.zeros(self.layout.size)
        self.ekf.P = self._start_covariance(heading)
        self.refused = {"force": 0, "heading": 0}
        self.gates = {k: float(chdtri(k, settings.gate_probability)) for k in (1, 2)}

    def advance(self, blocks: Blocks, k: int) -> Step:
        """Through block k: the target's motion, then its specific force and heading."""
        before, sea, dt = self.nominal, self.adaptation.sea, float(blocks.dt[k])
        steady = self._steady(dt)
        moved = move(before, steady, dt, float(blocks.gap[k]), blocks.rotation[k], sea, self.layout, self.settings)
        self.nominal, self.ekf.F, self.ekf.Q = moved.nominal, moved.transition, moved.noise
        self.ekf.predict()
        predicted, prior = self.nominal, self.ekf.P
        middle = before.rotation if self.layout.gyro else rotation_of(moved.turn / 2) @ before.rotation
        u, tilt = self._level_force(blocks.force[k], middle, steady, dt, before)
        force = self._force(u, tilt, float(blocks.force_variance[k]))
        heading = self._heading(float(blocks.heading[k]))
        if force.normalised is not None and not force.gated:
            self.adaptation.learn(dt, self.nominal, self.ekf.P, self.layout, force.normalised)
        return Step(self.nominal, self.ekf.P, tilt, moved.turn, force, heading, moved.transition, predicted, prior)

    def _level_force(
        self, force: np.ndarray, rotation: np.ndarray, steady: np.ndarray, dt: float, before: Nominal
    ) -> tuple[np.ndarray, np.ndarray]:
        """(3,) [m/s2] without its bias, and (2, size) how its x and y come from the attitude and the bias."""
        if self.layout.gyro:  # the mean was taken along the gyro's rotation, with its bias
            force = force - cross(0.5 * dt * before.gyro_bias, force)
        u = rotation @ (force - before.bias)
        tilt = np.zeros((2, self.layout.size))
        down = u[2] if self.settings.waves is None else g
        tilt[0, 1], tilt[1, 0] = -down, down
        tilt[:, self.layout.bias] = steady[:2]
        return u, tilt

    def _steady(self, dt: float) -> np.ndarray:
        """(3, 3) attitude at which errors are linearised: in a seaway without the waves' share, but for yaw.

        Errors that turn with roll and pitch, or grow with heave, could be told apart by it; but the same waves push the
        target sideways in step with that. What of it fits would be taken for a bias, and grow for minutes.
        """
        if self.settings.waves is None:
            return self.nominal.rotation
        yaw, *now = zyx_angles(self.nominal.rotation)
        self.elapsed += dt
        self.mean_tilt += dt / min(self.elapsed, self.settings.adapt_s) * (now - self.mean_tilt)
        return from_zyx_angles(np.array([yaw, *self.mean_tilt]))

    def _force(self, u: np.ndarray, tilt: np.ndarray, variance: float) -> Update:
        if not np.isfinite(variance):
            return Update()
        h = tilt.copy()
        if self.settings.waves is not None:
            for k, axis in enumerate(self.layout.axes):
                h[k, axis.start + wave_band.ACCELERATION] = 1.0
        else:
            variance *= self.adaptation.noise
        return self._update("force", u[:2] - self.nominal.acceleration, h, variance * np.eye(2))

    def _heading(self, heading: float) -> Update:
        if not np.isfinite(heading):
            return Update()
        yaw, pitch, _ = zyx_angles(self.nominal.rotation)
        h = np.zeros((1, self.layout.size))
        h[0, :3] = np.tan(pitch) * np.cos(yaw), np.tan(pitch) * np.sin(yaw), 1.0
        innovation = np.array([(heading - yaw + np.pi) % (2 * np.pi) - np.pi])
        return self._update("heading", innovation, h, self.settings.sensor.heading_noise**2 * np.eye(1))

    def _update(self, channel: str, innovation: np.ndarray, h: np.ndarray, noise: np.ndarray) -> Update:
        """Gate by the Mahalanobis distance; a sensor that is refused on and on must be heard again in the end."""
        spread = h @ self.ekf.P @ h.T + noise
        if self.refused[channel] >= _FORGIVEN:
            excess = 2.0 ** min(self.refused[channel] - _FORGIVEN + 1, 40) * np.diag(np.diag(spread))
            spread, noise = spread + excess, noise + excess
        normalised = np.linalg.solve(np.linalg.cholesky(spread), innovation)
        if normalised @ normalised > self.gates[len(innovation)]:
            self.refused[channel] += 1
            return Update(normalised, gated=True)
        self.refused[channel] = max(0, self.refused[channel] // 2)
        self.ekf.update(innovation, lambda x: h, lambda x: 0.0, R=noise)
        self.nominal = self.nominal.corrected(self.ekf.x, self.layout)
        self.ekf.x = np.zeros(self.layout.size)
        return Update(normalised)

    def _start_covariance(self, heading: bool) -> np.ndarray:
        s, settings, layout = self.settings.sensor, self.settings, self.layout
        p = np.zeros((layout.size, layout.size))
        wave = 0.0 if settings.waves is None else settings.waves.acceleration
        tilt = (2 * (wave + s.acceleration_bias) / g) ** 2 + np.deg2rad(0.5) ** 2
        if layout.gyro:
            tilt += (s.gyro_bias * settings.start_s) ** 2
            p[layout.rates, layout.rates] = s.gyro_bias**2 * np.eye(3)
        else:
            swing = swing_model(settings, settings.update_s).stationary
            tilt += 2 * swing[0, 0]
            p[layout.rates, layout.rates] = np.kron(swing, np.eye(3))
        p[:3, :3] = np.diag([tilt, tilt, _UNKNOWN_YAW**2 if heading else 0.0])
        p[layout.bias, layout.bias] = s.acceleration_bias**2 * np.eye(3)
        if self.adaptation.sea is not None:
            model = wave_model(self.adaptation.sea, settings.update_s)
            p[layout.band, layout.band] = np.kron(np.eye(2), model.stationary)
        return p


def start_rotation(first: Blocks, yaw: float) -> np.ndarray:
    """(3, 3) from the median of the blocks' specific forces, each turned back to the very first sample.

    Raises InputError where none of them has a good sample.
    """
    if not np.isfinite(first.force).any():
        raise InputError("attitude: the start has no good sample of tilt or acceleration; at least one is needed")
    back, forces = np.eye(3), []
    for force, rotation in zip(first.force, first.rotation, strict=True):
        forces.append(back @ force)
        back = back @ rotation_of(rotation)
    x, y, z = np.nanmedian(np.array(forces), axis=0)
    roll, pitch = np.arctan2(y, z), np.arctan2(-x, np.hypot(y, z))
    return from_zyx_angles(np.array([yaw, pitch, roll]))
