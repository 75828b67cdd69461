"""Static poses through the filter: error beside the white-noise bound, truth of its covariance, and speed.

    python -m benchmarks.static_poses

The industrial preset's tilt, 5 s at 50 Hz, one sample in a hundred 2 degrees off; 2000 poses by 20 seeds.
"""

import time

import numpy as np

from kincal.identification.attitude.presets import PRESETS
from kincal.identification.static_poses import static_attitude, static_attitudes
from kincal.urdf.description import Filter

POSES, SAMPLES, RATE_HZ = 2000, 250, 50.0

sigma = PRESETS["industrial"].tilt_noise
counts, t = np.full(POSES, SAMPLES), np.arange(POSES * SAMPLES) / RATE_HZ
ratios, held, seconds = [], [], []
for seed in range(20):
    random = np.random.default_rng([seed, 9])
    true = random.uniform(-0.4, 0.4, (POSES, 2))
    samples = np.repeat(true, SAMPLES, axis=0) + sigma * random.normal(size=(len(t), 2))
    wrong = random.random(len(t)) < 0.01
    samples[wrong] += np.deg2rad(2.0) * random.choice([-1.0, 1.0], (wrong.sum(), 2))
    began = time.process_time()
    found = static_attitudes(t, samples, counts, np.full(2, sigma), Filter())
    seconds.append(time.process_time() - began)
    errors = found.angles - true
    ratios.append(np.sqrt(np.mean(errors**2)) / (sigma / np.sqrt(SAMPLES)))
    held.append(np.mean(np.abs(errors) < 1.959964 * np.sqrt(found.variances)))
    if seed == 0:
        began = time.process_time()
        for k in range(20):
            rows = slice(k * SAMPLES, (k + 1) * SAMPLES)
            static_attitude(t[rows], samples[rows], np.full(2, sigma), Filter())
        alone = 20 * SAMPLES / (time.process_time() - began)
print(f"rms error over the white-noise bound: {np.mean(ratios):.3f} (worst seed {max(ratios):.3f})")
print(f"95 % intervals hold {np.mean(held):.2%} (seeds {min(held):.2%} to {max(held):.2%})")
print(f"all poses at once: {len(t) / np.median(seconds):,.0f} samples/s; filterpy, pose by pose: {alone:,.0f}")
