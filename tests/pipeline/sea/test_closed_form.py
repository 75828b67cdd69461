"""The closed-form responses against the paper's own expressions, physics, and a strip-theory table of a like ship."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError
from scipy.constants import g

from kincal.pipeline.sea.closed_form import ClosedFormRao
from kincal.pipeline.sea.rao import MODES
from kincal.pipeline.sea.rao_files import read_rao
from kincal.pipeline.sea.settings import SEA_STATES, Seaway, Vessel

SHIP = Vessel()
SURGE, SWAY, HEAVE, ROLL, PITCH, YAW = range(6)
frequencies = st.floats(0.15, 2.5)
directions = st.floats(0.0, 2 * np.pi)
speeds = st.floats(0.0, 12.0)


def response(frequency, direction_deg, speed=0.0, ship=SHIP) -> np.ndarray:
    return ClosedFormRao(ship).response(np.asarray(frequency, dtype=float), np.deg2rad(direction_deg), speed)


@given(frequencies, directions, speeds)
def test_heave_and_pitch_have_the_papers_amplitudes(w, beta, speed):
    """Jensen et al. 2004 in real numbers: eta F and eta G."""
    length, beam, draught = SHIP.length_m, SHIP.beam_m * SHIP.block_coefficient, SHIP.draught_m
    k = w**2 / g
    ke = abs(k * np.cos(beta))
    alpha = 1 - speed / np.sqrt(g * length) * np.sqrt(k * length) * np.cos(beta)
    if abs(alpha) < 1e-3 or ke * length < 1e-3:
        return
    a = 2 * np.sin(k * beam * alpha**2 / 2) * np.exp(-k * draught * alpha**2)
    f = np.sqrt((1 - k * draught) ** 2 + (a**2 / (k * beam * alpha**3)) ** 2)
    eta = 1 / np.sqrt((1 - 2 * k * draught * alpha**2) ** 2 + (a**2 / (k * beam * alpha**2)) ** 2)
    kappa, half = np.exp(-ke * draught), ke * length / 2
    heave = kappa * f * 2 / (ke * length) * np.sin(half)
    pitch = kappa * f * 24 / ((ke * length) ** 2 * length) * (np.sin(half) - half * np.cos(half))
    found = np.abs(ClosedFormRao(SHIP).response(np.array(w), np.array(beta), speed))
    assert found[HEAVE] == pytest.approx(eta * abs(heave), rel=1e-6, abs=1e-9)
    assert found[PITCH] == pytest.approx(eta * abs(pitch), rel=1e-5, abs=1e-9)


@pytest.mark.parametrize("ship", [SHIP, Vessel(beam_m=15.0, draught_m=6.0, roll_damping=0.05)])
@pytest.mark.parametrize("direction_deg, speed", [(120.0, 0.0), (75.0, 6.0), (89.0, 3.0)])
def test_roll_has_the_papers_amplitude(ship, direction_deg, speed):
    """Moment and damping of the two-beam hull in real numbers, per density, at a ship's beam of 2 g m for unit root."""
    w, beta = np.linspace(0.3, 1.4, 12), np.deg2rad(direction_deg)
    length, beam, draught, delta = ship.length_m, ship.beam_m, ship.draught_m, 0.6
    gamma = (ship.waterplane_coefficient - delta) / (1 - delta)
    area = ship.block_coefficient * beam * draught / (delta + gamma * (1 - delta))
    k = w**2 / g
    ke, we = np.abs(k * np.cos(beta)), np.abs(w - k * speed * np.cos(beta))

    def b44(a, b):
        ratio, n = max(b / draught, 1.0), we * np.sqrt(b / (2 * g))
        fit = (
            (0.256 * ratio - 0.286, -0.11 * ratio - 2.55, 0.033 * ratio - 1.419)
            if ratio >= 3
            else (-3.94 * ratio + 13.69, -2.12 * ratio - 1.89, 1.16 * ratio - 7.97)
        )
        return a * b**2 / np.sqrt(b / (2 * g)) * fit[0] * np.exp(fit[1] * n**-1.3) * n ** fit[2]

    aft, fore = b44(area, beam), b44(gamma * area, gamma * beam)
    kappa = np.sqrt(fore / aft)
    sa, sf = np.sin(delta * length * ke / 2), np.sin((1 - delta) * length * ke / 2)
    shape = np.sqrt(sa**2 + kappa**2 * sf**2 + 2 * kappa * sa * sf * np.cos(length * ke / 2))
    moment = np.abs(np.sin(beta)) * np.sqrt(g**2 / we) * 2 / ke * np.sqrt(aft) * shape
    c44 = g * ship.block_coefficient * length * beam * draught * ship.metacentric_height
    tn = ship.roll_period
    damping = length * aft * (delta + kappa**2 * (1 - delta)) + ship.roll_damping * c44 * tn / np.pi
    expected = moment / np.sqrt(((1 - (we * tn / (2 * np.pi)) ** 2) * c44) ** 2 + (we * damping) ** 2)
    assert np.abs(response(w, direction_deg, speed, ship)[:, ROLL]) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("direction_deg", [0.0, 40.0, 120.0, 180.0, 250.0])
@pytest.mark.parametrize("speed", [0.0, 8.0])
def test_in_long_waves_the_ship_goes_with_the_water(direction_deg, speed):
    """Elevation Re exp(i (w_e t - k (x cos + y sin))): heave 1, pitch its slope (bow down), orbits of one metre."""
    w = 0.02
    k, beta = w**2 / g, np.deg2rad(direction_deg)
    found = response(w, direction_deg, speed)
    along, across = np.cos(beta), np.sin(beta)
    assert found[HEAVE] == pytest.approx(1, abs=1e-3)
    assert found[PITCH] / k == pytest.approx(1j * along, abs=2e-3)
    assert found[[SURGE, SWAY]] == pytest.approx(np.array([-1j * along, -1j * across]), abs=1e-3)
    assert found[YAW] / k == pytest.approx(-along * across, abs=1e-3)


@given(frequencies, directions, speeds)
def test_port_is_like_starboard(w, beta, speed):
    rao = ClosedFormRao(SHIP)
    here, mirrored = (rao.response(np.array(w), np.array(b), speed) for b in (beta, -beta))
    assert mirrored == pytest.approx(here * [1, -1, 1, -1, 1, -1], abs=1e-9)


@given(frequencies, directions, speeds)
def test_responses_are_finite_and_of_a_ships_size(w, beta, speed):
    found = np.abs(ClosedFormRao(SHIP).response(np.array(w), np.array(beta), speed))
    assert np.isfinite(found).all()
    assert (found < [1.01, 1.01, 4, 0.6, 0.2, 0.1]).all()


def test_damping_takes_energy():
    """From below to above resonance, roll's lag behind the slope of a beam sea grows from 0 to half a turn."""
    lag = -np.angle(response([0.1, 2 * np.pi / SHIP.roll_period, 2.0], 90.0)[:, ROLL] / -1j)
    assert lag == pytest.approx([0, np.pi / 2, np.pi], abs=0.3)
    assert (lag > 0).all()


def test_it_resembles_strip_theory(shared_data):
    """The supply ship's own table: not the same numbers, but the same ship; roll is damped far more there."""
    table = read_rao(shared_data / "mss_supply_vessel" / "supply.mat", 0.0)
    w, beta = np.array([0.25, 0.35, 0.45, 0.55]), np.deg2rad([[180.0], [240.0], [300.0], [0.0]])
    strip, closed = (rao.response(w, beta, 0.0) for rao in (table, ClosedFormRao(SHIP)))
    for mode, size, within in ((SURGE, 1.0, 0.15), (SWAY, 1.0, 0.1), (HEAVE, 1.0, 0.12), (PITCH, 0.02, 0.3)):
        assert closed[..., mode] / size == pytest.approx(strip[..., mode] / size, abs=within), MODES[mode]
    assert closed[1:3, :, YAW] / 0.01 == pytest.approx(strip[1:3, :, YAW] / 0.01, abs=0.5)
    turn = np.angle(closed[1:3, :, ROLL] / strip[1:3, :, ROLL])
    assert np.abs(turn).max() < np.deg2rad(80)


@pytest.mark.parametrize(
    "table, field",
    [
        ({"sea_state": 2}, "sea_state"),
        ({"rate_hz": 0.0}, "rate_hz"),
        ({"minutes": -1.0}, "minutes"),
        ({"wind": 3.0}, "wind"),
        ({"heading_deg": float("nan")}, "heading_deg"),
        ({"vessel": {"beam_m": 50.0}}, "draught_m"),
        ({"vessel": {"length_m": 30.0}}, "length_m"),
        ({"vessel": {"waterplane_coefficient": 0.5}}, "waterplane"),
    ],
)
def test_settings_are_checked(table, field):
    with pytest.raises(ValidationError, match=field):
        Seaway.model_validate(table)


def test_sea_states_lie_in_the_codes_ranges():
    """The World Meteorological Organization's code table 3700."""
    for state, (low, high) in {3: (0.5, 1.25), 4: (1.25, 2.5), 5: (2.5, 4.0), 6: (4.0, 6.0)}.items():
        assert low < SEA_STATES[state][0] < high
        assert Seaway(sea_state=state).significant_height == SEA_STATES[state][0]
    assert Seaway(sea_state=6, peak_period_s=11.0).peak_period == 11.0
