"""Rates and accelerations on board, and which way each sign points."""

import numpy as np
import pytest
from scipy.constants import g
from scipy.spatial.transform import Rotation

from kincal.pipeline.sea.closed_form import ClosedFormRao
from kincal.pipeline.sea.rao_files import read_rao
from kincal.pipeline.sea.settings import Seaway, Vessel
from kincal.pipeline.sea.ship_motion import ShipMotion
from kincal.pipeline.sea.synthesis import generated

DEG = np.pi / 180
BOW, PORT, UP = np.eye(3)


def still(roll_deg=0.0, pitch_deg=0.0, yaw_deg=0.0) -> ShipMotion:
    """One sample at rest."""
    zero = np.zeros((1, 3))
    return ShipMotion(np.zeros(1), zero, zero, zero, np.array([[roll_deg, pitch_deg, yaw_deg]]) * DEG, zero, zero)


def violent() -> ShipMotion:
    """Large and fast motion, where no small-angle shortcut would pass."""
    sea = Seaway(minutes=0.2, rate_hz=200, significant_height_m=9.0, peak_period_s=7.0, heading_deg=130.0)
    return generated(sea, ClosedFormRao(Vessel(length_m=30.0, beam_m=8.0, draught_m=2.5)))


def test_signs_of_a_known_attitude():
    """Roll lifts the port side, pitch buries the bow, yaw turns the bow to port; NMEA's pitch lifts the bow."""
    for motion, point, z in (
        (still(roll_deg=5), PORT, np.sin(5 * DEG)),
        (still(pitch_deg=5), BOW, -np.sin(5 * DEG)),
        (still(roll_deg=5, yaw_deg=90), PORT, np.sin(5 * DEG)),
    ):
        assert (motion.rotation[0] @ point)[2] == pytest.approx(z)
    assert still(yaw_deg=90).rotation[0] @ BOW == pytest.approx(PORT)
    roll, pitch, heading = still(roll_deg=3, pitch_deg=-2, yaw_deg=10).nmea_deg(course_deg=5)[0]
    assert (roll, pitch, heading) == pytest.approx((3.0, 2.0, 355.0))
    bow_up = still(pitch_deg=-2)
    assert (bow_up.rotation[0] @ BOW)[2] > 0
    assert bow_up.nmea_deg()[0, 1] == pytest.approx(2.0)


def test_accelerometers_at_rest_read_the_way_up():
    """Port side up: the y axis has a part of up; bow up: the x axis has."""
    assert still().specific_force()[0] == pytest.approx(g * UP)
    assert still(roll_deg=5).specific_force()[0] == pytest.approx(g * np.array([0, np.sin(5 * DEG), np.cos(5 * DEG)]))
    assert still(pitch_deg=-5).specific_force()[0] == pytest.approx(g * np.array([np.sin(5 * DEG), 0, np.cos(5 * DEG)]))


def test_gyros_read_the_rotation():
    """Against rotation vectors between neighbouring samples; and the derivative of the rate."""
    motion = violent()
    assert np.abs(motion.roll).max() > 10 * DEG
    rotation, h = Rotation.from_matrix(motion.rotation), motion.t[1]
    between = (rotation[:-2].inv() * rotation[2:]).as_rotvec() / (2 * h)
    assert between == pytest.approx(motion.angular_rate[1:-1], abs=2e-4)
    w = motion.angular_rate
    stencil = (8 * (w[3:-1] - w[1:-3]) - (w[4:] - w[:-4])) / (12 * h)
    assert stencil == pytest.approx(motion.angular_acceleration[2:-2], abs=1e-6)


def test_accelerometers_read_the_lever_arms_path():
    motion, lever, h = violent(), np.array([12.0, -3.0, 9.0]), 1 / 200
    p = motion.position + motion.rotation @ lever
    second = (-p[4:] + 16 * p[3:-1] - 30 * p[2:-2] + 16 * p[1:-3] - p[:-4]) / (12 * h**2)
    assert second == pytest.approx(motion.acceleration_at(lever)[2:-2], abs=1e-5)
    force = np.einsum("nji,nj->ni", motion.rotation[2:-2], second + g * UP)
    assert force == pytest.approx(motion.specific_force(lever)[2:-2], abs=1e-5)


@pytest.mark.parametrize("heading_deg", [0.0, 60.0, 180.0])
def test_a_ship_on_a_long_wave_lies_on_the_water(heading_deg):
    """One wave thirty ship lengths long: points of the deck go up and down with the surface below them, and forces
    along the deck vanish, as water does not flow along its own surface."""
    w, beta, a = 0.157, np.deg2rad(heading_deg), 2.0
    k, t = w**2 / g, np.linspace(0, 2 * np.pi / 0.157, 50)
    h = ClosedFormRao(Vessel()).response(np.array(w), np.array(beta), 0.0)
    harmonics = a * np.exp(1j * w * t)[:, None] * h
    parts = [((1j * w) ** n * harmonics).real for n in range(3)]
    motion = ShipMotion(t, *(p[:, :3] for p in parts), *(p[:, 3:] for p in parts))
    x = 40.0
    deck = motion.position[:, 2] + (motion.rotation @ (x * BOW))[:, 2]
    water = a * np.cos(w * t - k * x * np.cos(beta))
    assert deck == pytest.approx(water, abs=0.02 * a)
    along = motion.specific_force()[:, 0]
    assert np.abs(along).max() < 0.06 * a * k * g
    assert np.abs(g * np.sin(motion.pitch)).max() == pytest.approx(a * k * g * abs(np.cos(beta)), rel=0.03)


@pytest.mark.parametrize("heading_deg", [90.0, 120.0, 270.0])
@pytest.mark.parametrize("source", ["table", "closed forms"])
def test_the_ship_heels_with_the_slope_and_is_carried_by_the_wave(heading_deg, source, request):
    """Waves slower than the roll period: port goes up where the surface rises to port, and a crest carries the ship
    the way the waves go: sway's velocity is in phase with the elevation."""
    if source == "table":
        rao = read_rao(request.getfixturevalue("shared_data") / "mss_supply_vessel" / "supply.mat", 0.0)
    else:
        rao = ClosedFormRao(Vessel())
    w, beta = 0.3, np.deg2rad(heading_deg)
    surge, sway, heave, roll, pitch, _ = rao.response(np.array(w), np.array(beta), 0.0)
    slope_to_port, slope_to_bow = -1j * w**2 / g * np.array([np.sin(beta), np.cos(beta)])
    assert abs(np.angle(roll / slope_to_port)) < 0.5
    assert (1j * w * sway / np.sin(beta)).real > 0.2
    assert heave.real > 0.9
    if abs(np.cos(beta)) > 0.1:
        assert abs(np.angle(-pitch / slope_to_bow)) < 0.1
        assert (1j * w * surge / np.cos(beta)).real > 0.2
