"""What the spectra tell of the motion before it is generated, by waveresponse."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

import numpy as np

from kincal.pipeline.sea.rao import Rao
from kincal.pipeline.sea.settings import Seaway
from kincal.pipeline.sea.waves import spectrum, spreading

if TYPE_CHECKING:
    from waveresponse import DirectionalBinSpectrum, WaveBinSpectrum

_DIRECTIONS = 72  # of a spread sea
# waveresponse's words for directions as ours: counted from x towards y, z up, to where the waves travel
CONVENTION = {"clockwise": False, "waves_coming_from": False}


def wave_spectrum(sea: Seaway) -> WaveBinSpectrum:
    """The sea over the frequencies of the waves [rad/s], in bins of directions [rad]."""
    from waveresponse import WaveBinSpectrum

    frequency, density = spectrum(sea)
    if sea.spreading is None:
        return WaveBinSpectrum(frequency, [sea.heading % (2 * np.pi)], density[:, None], **CONVENTION)
    direction = np.arange(_DIRECTIONS) * 2 * np.pi / _DIRECTIONS
    share = spreading(sea.spreading, np.mod(direction - sea.heading, 2 * np.pi)) * 2 * np.pi / _DIRECTIONS
    return WaveBinSpectrum(frequency, direction, density[:, None] * share, **CONVENTION)


def response_spectra(sea: Seaway, rao: Rao) -> list[DirectionalBinSpectrum]:
    """Response spectra of surge, sway, heave, roll, pitch, yaw over the frequencies of the waves, not of encounter."""
    from waveresponse import RAO, calculate_response

    waves = wave_spectrum(sea)
    frequency, direction = waves.freq(freq_hz=False), waves.dirs(degrees=False)
    values = np.moveaxis(rao.response(frequency[:, None], direction[None, :], sea.speed), 2, 0)
    raos = [RAO(frequency, direction, mode, **CONVENTION) for mode in values]
    spectra = [calculate_response(mode, waves, 0.0, reshape="rao") for mode in raos]  # "rao": the grids are the same
    return cast("list[DirectionalBinSpectrum]", spectra)


def expected_std(sea: Seaway, rao: Rao) -> np.ndarray:
    """(6,) standard deviations of surge, sway, heave [m], roll, pitch, yaw [rad]."""
    return np.array([response.std() for response in response_spectra(sea, rao)])
