"""What the spectra tell of the motion before it is generated, by waveresponse."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pipeline.sea.rao import Rao
from pipeline.sea.settings import Seaway
from pipeline.sea.waves import spectrum, spreading

if TYPE_CHECKING:
    from waveresponse import DirectionalBinSpectrum, DirectionalSpectrum, WaveBinSpectrum, WaveSpectrum

_DIRECTIONS = 72  # of a spread sea
# waveresponse's words for directions as ours: counted from x towards y, z up, to where the waves travel
CONVENTION = {"clockwise": False, "waves_coming_from": False}


def wave_spectrum(sea: Seaway) -> WaveSpectrum | WaveBinSpectrum:
    """The sea over the frequencies of the waves [rad/s] and their directions [rad]."""
    from waveresponse import WaveBinSpectrum, WaveSpectrum

    frequency, density = spectrum(sea)
    if sea.spreading is None:
        return WaveBinSpectrum(frequency, [sea.heading % (2 * np.pi)], density[:, None], **CONVENTION)
    direction = np.arange(_DIRECTIONS) * 2 * np.pi / _DIRECTIONS
    over = spreading(sea.spreading, np.mod(direction - sea.heading, 2 * np.pi))
    return WaveSpectrum(frequency, direction, density[:, None] * over, **CONVENTION)


def response_spectra(sea: Seaway, rao: Rao) -> list[DirectionalSpectrum | DirectionalBinSpectrum]:
    """Response spectra of surge, sway, heave, roll, pitch, yaw over the frequencies of the waves, not of encounter."""
    from waveresponse import RAO, calculate_response

    waves = wave_spectrum(sea)
    frequency, direction = waves.freq(freq_hz=False), waves.dirs(degrees=False)
    values = np.moveaxis(rao.response(frequency[:, None], direction[None, :], sea.speed), 2, 0)
    return [calculate_response(RAO(frequency, direction, mode, **CONVENTION), waves, 0.0) for mode in values]


def expected_std(sea: Seaway, rao: Rao) -> np.ndarray:
    """(6,) standard deviations of surge, sway, heave [m], roll, pitch, yaw [rad]."""
    return np.array([response.std() for response in response_spectra(sea, rao)])
