"""Roll and pitch of a vessel in sea state 5 after a cold start, beside the peers, all on the same samples.

    python -m benchmarks.attitude [--seeds 20] [--seconds 330]

Industrial MEMS noise, unknown biases of gyro and accelerometer, lateral acceleration on. rms over the seeds and the
30 s from each time on, in degrees: as it is, and net of the accelerometer's bias (the tilt that its turn-on bias looks
like to anything on board). Peers: smsfusion's VRU with its defaults, and told of the same noise; Madgwick's filter;
the accelerometer alone.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.constants import g

from kincal.identification.attitude.filter import filter_attitude
from kincal.identification.attitude.presets import PRESETS
from kincal.identification.attitude.settings import AttitudeEstimate, AttitudeSettings, Samples
from kincal.identification.attitude.smoother import smooth_attitude
from kincal.pipeline.sea.instruments import sensed
from kincal.pipeline.sea.settings import Seaway
from kincal.pipeline.sea.ship_motion import ShipMotion
from kincal.pipeline.sea.synthesis import generated, rao_of
from kincal.urdf.rigid_motion import from_zyx_angles

RATE_HZ = 50.0
TIMES, WINDOW_S = (60, 120, 300), 30
SENSOR = PRESETS["industrial"]


@dataclass(frozen=True)
class Record:
    motion: ShipMotion
    acceleration: np.ndarray  # (n, 3) as measured
    gyro: np.ndarray
    bias: np.ndarray  # (3,) of the accelerometer at switch-on

    def bias_tilt(self) -> np.ndarray:
        """(n, 2) the error of roll and pitch that the accelerometer's bias looks like [rad]."""
        angles = self.motion.angles * [1.0, 1.0, 0.0]
        level = from_zyx_angles(angles[:, ::-1]) @ self.bias
        return np.stack([level[:, 1], -level[:, 0]], axis=1) / g


def record(sea_state: Literal[3, 4, 5, 6], seconds: float, seed: int) -> Record:
    """Of the default ship, as `kincal sea-trial` moves her, measured where she turns."""
    sea = Seaway(sea_state=sea_state, minutes=seconds / 60, rate_hz=RATE_HZ, seed=seed)
    motion = generated(sea, rao_of(sea))
    found = sensed(motion.specific_force(), motion.angular_rate, RATE_HZ, SENSOR, [seed, 22])
    assert found.samples.acceleration is not None
    assert found.samples.gyro is not None
    return Record(motion, found.samples.acceleration, found.samples.gyro, found.bias)


def accelerometer_alone(record: Record) -> np.ndarray:
    x, y, z = record.acceleration.T
    return np.stack([np.arctan2(y, z), np.arctan2(-x, np.hypot(y, z))], axis=1)


def madgwick(record: Record, gain: float = 0.0025) -> np.ndarray:
    """Madgwick, Harrison, Vaidyanathan 2011: gradient descent towards gravity; the gain is the best on other seeds."""
    w, x, y, z = 1.0, 0.0, 0.0, 0.0
    dt, found = 1 / RATE_HZ, np.empty((len(record.gyro), 2))
    roll, pitch = np.median(accelerometer_alone(record)[: int(5 * RATE_HZ)], axis=0) / 2
    w, x = np.cos(roll) * np.cos(pitch), np.sin(roll) * np.cos(pitch)
    y, z = np.cos(roll) * np.sin(pitch), -np.sin(roll) * np.sin(pitch)
    for k, ((p, q, r), force) in enumerate(zip(record.gyro.tolist(), record.acceleration, strict=True)):
        ax, ay, az = (force / np.linalg.norm(force)).tolist()
        f = 2 * (x * z - w * y) - ax, 2 * (w * x + y * z) - ay, 2 * (0.5 - x * x - y * y) - az
        step = np.array(
            [
                -2 * y * f[0] + 2 * x * f[1],
                2 * z * f[0] + 2 * w * f[1] - 4 * x * f[2],
                -2 * w * f[0] + 2 * z * f[1] - 4 * y * f[2],
                2 * x * f[0] + 2 * y * f[1],
            ]
        )
        step *= gain / max(float(np.linalg.norm(step)), 1e-12)
        rate = 0.5 * np.array(
            [-x * p - y * q - z * r, w * p + y * r - z * q, w * q - x * r + z * p, w * r + x * q - y * p]
        )
        quaternion = np.array([w, x, y, z]) + dt * (rate - step)
        w, x, y, z = (quaternion / np.linalg.norm(quaternion)).tolist()
        found[k] = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)), np.arcsin(2 * (w * y - x * z))
    return found


def vru(record: Record, told: bool) -> np.ndarray:
    """smsfusion's; told: of the sensor's noise and of how little is known at the start, else with its defaults."""
    import smsfusion

    options: dict = {}
    if told:
        start = [1e-6] * 6 + [np.deg2rad(2.0) ** 2] * 3 + [SENSOR.gyro_bias**2] * 3
        options = {
            "P0_prior": np.diag(start),
            "err_acc": {
                "N": SENSOR.acceleration_noise,
                "B": SENSOR.acceleration_instability,
                "tau_cb": SENSOR.instability_s,
            },
            "err_gyro": {"N": SENSOR.gyro_noise, "B": SENSOR.gyro_instability, "tau_cb": SENSOR.instability_s},
        }
    unit, found = smsfusion.VRU(RATE_HZ, nav_frame="ENU", **options), np.empty((len(record.gyro), 2))
    for k, (force, rate) in enumerate(zip(record.acceleration, record.gyro, strict=True)):
        found[k] = unit.update(force, rate).euler()[:2]
    return found


def main() -> None:
    options = argparse.ArgumentParser()
    options.add_argument("--seeds", type=int, default=20)
    options.add_argument("--seconds", type=float, default=TIMES[-1] + WINDOW_S)
    options.add_argument("--sea-state", type=int, default=5)
    asked = options.parse_args()
    settings = AttitudeSettings(sensor=SENSOR)
    estimates: list[AttitudeEstimate] = []

    def ours(record: Record) -> np.ndarray:
        estimates.append(filter_attitude(record.motion.t, Samples(record.acceleration, record.gyro), settings))
        return estimates[-1].roll_pitch_yaw[:, :2]

    def smoothed(record: Record) -> np.ndarray:
        samples = Samples(record.acceleration, record.gyro)
        return smooth_attitude(record.motion.t, samples, settings).roll_pitch_yaw[:, :2]

    methods: dict[str, Callable[[Record], np.ndarray]] = {
        "kincal filter": ours,
        "kincal smoother": smoothed,
        "smsfusion VRU, told": lambda r: vru(r, told=True),
        "smsfusion VRU, defaults": lambda r: vru(r, told=False),
        "Madgwick": madgwick,
        "accelerometer alone": accelerometer_alone,
    }
    squares: dict[str, list] = {name: [] for name in methods}
    seconds, within, bias = dict.fromkeys(methods, 0.0), [], []
    for seed in range(asked.seeds):
        sample = record(asked.sea_state, asked.seconds, seed)
        bias.append(np.mean(sample.bias_tilt() ** 2))
        windows = [(sample.motion.t >= s) & (sample.motion.t < s + WINDOW_S) for s in TIMES]
        for name, method in methods.items():
            began = time.process_time()
            errors = method(sample) - sample.motion.angles[:, :2]
            seconds[name] += time.process_time() - began
            net = errors - sample.bias_tilt()
            squares[name].append([[np.mean(e[w] ** 2) for w in windows] for e in (net, errors)])
            if name == "kincal filter":
                normed = net / estimates[-1].bias_free_std
                within.append(np.mean(np.abs(normed[windows[0] | windows[1] | windows[2]]) < 1.959964))
    samples = asked.seeds * asked.seconds * RATE_HZ
    print(f"sea state {asked.sea_state}, {asked.seeds} seeds, {RATE_HZ:g} Hz, sensor {SENSOR.name}; rms in degrees")
    print(f"{'':26}{'net of the bias after':>30} s{'as it is after':>28} s   samples/s")
    print(f"{'':26}" + "".join(f"{s:10d}" for s in (*TIMES, *TIMES)))
    for name, found in squares.items():
        net, whole = np.rad2deg(np.sqrt(np.mean(found, axis=0)))
        print(f"{name:26}" + "".join(f"{x:10.4f}" for x in (*net, *whole)) + f"{samples / seconds[name]:12.0f}")
    print(f"the accelerometer's bias alone: {np.rad2deg(np.sqrt(np.mean(bias))):.4f} degrees rms")
    statistics = [e.innovations[0] for e in estimates]
    inside = sum(s.band[0] <= s.mean <= s.band[1] for s in statistics)
    print(
        f"normalised innovations squared: mean {np.mean([s.mean for s in statistics]):.3f}, within the 95 % band of "
        f"their mean in {inside} of {len(statistics)} seeds; {np.mean([s.inside for s in statistics]):.3f} within "
        f"their own; lag one {np.mean([s.lag_one for s in statistics]):.2f}; "
        f"errors within the filter's 95 %: {np.mean(within):.3f}"
    )


if __name__ == "__main__":
    main()
