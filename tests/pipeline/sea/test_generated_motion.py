"""Generated ship motion: statistics, spectra and derivatives."""

import warnings
from dataclasses import fields

import numpy as np
import pytest
from scipy.constants import g, knot
from scipy.io import loadmat
from scipy.signal import periodogram
from waveresponse import RAO, WaveBinSpectrum, calculate_response

from kincal.pipeline.sea.closed_form import ClosedFormRao
from kincal.pipeline.sea.response import expected_std, response_spectra, wave_spectrum
from kincal.pipeline.sea.settings import SEA_STATES, Seaway
from kincal.pipeline.sea.ship_motion import ShipMotion
from kincal.pipeline.sea.synthesis import generated, rao_of, superposed
from kincal.pipeline.sea.waves import drawn, spectrum


def stds(motion: ShipMotion) -> np.ndarray:
    """(6,) of surge to yaw [m, rad]."""
    return np.concatenate([motion.position.std(axis=0), motion.angles.std(axis=0)])


def mean_std(sea: Seaway, records: int) -> np.ndarray:
    rao = rao_of(sea)
    return np.mean([stds(generated(sea.model_copy(update={"seed": s}), rao)) for s in range(records)], axis=0)


def three_hours(**settings) -> Seaway:
    return Seaway(minutes=180, rate_hz=1, **settings)


@pytest.mark.parametrize(
    "sea, records",
    [
        (three_hours(), 20),
        (three_hours(sea_state=6, spreading=1, heading_deg=200.0), 20),
        (three_hours(sea_state=4, speed_knots=12.0, heading_deg=165.0), 5),
        (three_hours(sea_state=6, speed_knots=15.0, heading_deg=30.0), 20),
    ],
)
def test_records_have_the_spectrums_standard_deviations(sea, records):
    """Means over records of three hours, within 3 % of waveresponse's; most of it is their own scatter."""
    assert mean_std(sea, records) == pytest.approx(expected_std(sea, rao_of(sea)), rel=0.03)


def test_the_supply_ship_in_sea_state_5(shared_data):
    """Her strip-theory table at 120 degrees, Hs 3.25 m, Tp 9.7 s: about 1.9 degrees of roll and 1.2 of pitch.

    Expected is what waveresponse makes of the file as it is, whose headings run clockwise.
    """
    sea = three_hours(heading_deg=120.0, rao=shared_data / "mss_supply_vessel" / "supply.mat")
    vessel = loadmat(sea.rao, squeeze_me=True, struct_as_record=False)["vessel"]
    table, clockwise = vessel.motionRAO, {"clockwise": True, "waves_coming_from": False}
    waves = WaveBinSpectrum(spectrum(sea)[0], [240.0], spectrum(sea)[1][:, None], degrees=True, **clockwise)
    expected = []
    for amplitude, phase in zip(table.amp, table.phase, strict=True):
        rao = RAO.from_amp_phase(
            table.w, vessel.headings, amplitude[:, :, 0], phase[:, :, 0], freq_hz=False, degrees=False, **clockwise
        )
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "The `Grid.reshape`", DeprecationWarning)  # waveresponse's own
            expected.append(calculate_response(rao, waves, 0.0).std())
    assert expected_std(sea, rao_of(sea)) == pytest.approx(expected, rel=1e-6)
    assert np.rad2deg(expected[3:5]) == pytest.approx([1.9, 1.2], abs=0.05)
    assert mean_std(sea, 20) == pytest.approx(expected, rel=0.03)


@pytest.mark.parametrize("state", SEA_STATES)
def test_waves_have_the_sea_states_height(state):
    sea = Seaway(sea_state=state)
    waves = drawn(sea)
    assert wave_spectrum(sea).hs == pytest.approx(SEA_STATES[state][0], rel=0.005)
    assert wave_spectrum(sea).tp == pytest.approx(SEA_STATES[state][1], rel=0.005)
    assert 4 * np.sqrt(np.sum(waves.amplitude**2) / 2) == pytest.approx(SEA_STATES[state][0], rel=0.005)


def test_a_spread_sea_has_its_spread():
    """cos^2 within +-90 degrees: a standard deviation of sqrt(pi^2 / 12 - 1 / 2)."""
    apart = drawn(Seaway(spreading=1)).direction - np.deg2rad(120.0)
    assert np.abs(apart).max() < np.pi / 2
    assert apart.std() == pytest.approx(np.sqrt(np.pi**2 / 12 - 0.5), rel=0.01)
    assert abs(np.corrcoef(apart, drawn(Seaway(spreading=1)).frequency)[0, 1]) < 0.1


@pytest.mark.parametrize("heading_deg, speed_knots", [(0.0, 20.0), (120.0, 10.0), (180.0, 5.0)])
def test_waves_are_met_at_the_frequency_of_encounter(heading_deg, speed_knots):
    """By the Doppler effect on each wave's phase speed g / w; a fast ship overtakes the short waves she follows."""
    waves = drawn(Seaway(heading_deg=heading_deg, speed_knots=speed_knots))
    with_the_waves = speed_knots * knot * np.cos(np.deg2rad(heading_deg))
    assert waves.encounter == pytest.approx(waves.frequency * (1 - with_the_waves / (g / waves.frequency)))
    assert (waves.encounter < 0).any() == (heading_deg == 0.0)


def test_the_records_spectrum_is_the_responses():
    """Variance of twenty records in bands of the frequency of encounter, bow sea, of heave, roll and pitch."""
    sea = three_hours(heading_deg=150.0, speed_knots=10.0)
    rao = ClosedFormRao(sea.vessel)
    w, _ = spectrum(sea)
    met = w - w**2 * sea.speed * np.cos(sea.heading) / g
    edges = np.quantile(met, [0.0, 0.05, 0.1, 0.15, 0.2, 0.3, 1.0])
    motions = [generated(sea.model_copy(update={"seed": s}), rao) for s in range(20)]
    for mode in (2, 3, 4):
        _, density = response_spectra(sea, rao)[mode].spectrum1d(freq_hz=False)
        total = np.trapezoid(density, w)
        below = np.interp(edges, met, np.concatenate([[0], np.cumsum(np.diff(w) * (density[1:] + density[:-1]) / 2)]))
        found = np.zeros(len(edges) - 1)
        for motion in motions:
            record = np.column_stack([motion.position, motion.angles])[:, mode]
            f, power = periodogram(record, fs=sea.rate_hz)
            found += np.histogram(2 * np.pi * f, edges, weights=power * f[1])[0] / len(motions)
        assert found / total == pytest.approx(np.diff(below) / total, abs=0.02)


def test_sums_are_those_of_the_harmonics():
    random = np.random.default_rng(0)
    frequency, t = random.uniform(-2, 2, 40), np.arange(1234) / 7
    harmonics = random.normal(size=(40, 3)) + 1j * random.normal(size=(40, 3))
    one_by_one = np.exp(1j * np.outer(t, frequency)) @ harmonics
    assert superposed(frequency, harmonics, t) == pytest.approx(one_by_one.real, abs=1e-9)


@pytest.mark.parametrize("what, derivative", [("position", "velocity"), ("velocity", "acceleration")])
def test_derivatives_are_those_of_the_record(what, derivative):
    motion = generated(Seaway(minutes=1, rate_hz=50, speed_knots=8.0), ClosedFormRao(Seaway().vessel))
    for of, to in ((what, derivative), (*(_of_angles(n) for n in (what, derivative)),)):
        y, h = getattr(motion, of), motion.t[1]
        stencil = (8 * (y[3:-1] - y[1:-3]) - (y[4:] - y[:-4])) / (12 * h)
        assert stencil == pytest.approx(getattr(motion, to)[2:-2], abs=2e-6)


def _of_angles(name: str) -> str:
    return {"position": "angles", "velocity": "angle_rates", "acceleration": "angle_accelerations"}[name]


def test_a_record_does_not_repeat():
    """No later stretch of three hours is like the first five minutes: correlations stay those of chance."""
    roll = generated(three_hours(), ClosedFormRao(Seaway().vessel)).roll
    first = roll[:300] / np.linalg.norm(roll[:300])
    later = np.array(
        [roll[k : k + 300] @ first / np.linalg.norm(roll[k : k + 300]) for k in range(300, len(roll) - 300)]
    )
    assert np.abs(later).max() < 0.8


def test_a_seed_gives_the_same_record_again():
    sea = Seaway(minutes=0.5, rate_hz=10, seed=3)
    one, again = (generated(sea, rao_of(sea)) for _ in range(2))
    other = generated(sea.model_copy(update={"seed": 4}), rao_of(sea))
    assert all(np.array_equal(getattr(one, f.name), getattr(again, f.name)) for f in fields(ShipMotion))
    assert np.abs(one.roll - other.roll).max() > 0.01
    assert len(one) == 300


def test_the_rate_does_not_change_the_motion():
    slow, fast = (generated(Seaway(minutes=1, rate_hz=r), ClosedFormRao(Seaway().vessel)) for r in (10, 100))
    assert fast.angles[::10] == pytest.approx(slow.angles, abs=1e-9)
    assert fast.acceleration[::10] == pytest.approx(slow.acceleration, abs=1e-9)
