"""The replay of recorded motion: against motion that is known between the samples, and a real ship's log."""

from datetime import datetime

import numpy as np
import pytest

from kincal.pipeline.sea.closed_form import ClosedFormRao
from kincal.pipeline.sea.replay import replayed
from kincal.pipeline.sea.settings import Seaway, Vessel
from kincal.pipeline.sea.synthesis import generated
from kincal.urdf.errors import InputError

DEG = np.pi / 180


@pytest.fixture(scope="module")
def known():
    """Five minutes at 100 Hz."""
    return generated(Seaway(minutes=5), ClosedFormRao(Vessel()))


def test_a_log_of_one_hertz_gives_the_motion_between_its_samples(known):
    """Rounded to 0.01 degrees and 0.01 m as a log has it: errors are hardly more than the rounding's own 0.003."""
    logged = [np.round(x, 2) for x in (known.roll / DEG, known.pitch / DEG, known.yaw / DEG, known.heave)]
    roll, pitch, yaw, heave = (x[::100] for x in logged)
    motion = replayed(known.t[::100] + 7.0, roll * DEG, pitch * DEG, yaw * DEG, heave, 100.0, "log")
    inner = slice(500, len(motion) - 500)
    assert motion.t[-1] == pytest.approx(299.0)

    def rms(name: str, unit: float, column=slice(None)) -> float:
        both = (getattr(m, name)[: len(motion)][inner][:, column] for m in (motion, known))
        return float(np.sqrt(np.mean(np.subtract(*both) ** 2)) / unit)

    assert rms("angles", DEG) < 0.004
    assert rms("angle_rates", DEG) < 0.008
    assert rms("angle_accelerations", DEG) < 0.02
    assert rms("position", 1.0, 2) < 0.004
    assert rms("acceleration", 1.0, 2) < 0.02


def test_samples_are_kept_and_times_may_be_uneven(known):
    """At the log's own samples the replay is the log."""
    random = np.random.default_rng(1)
    rows = np.sort(random.choice(np.arange(1, 6000), 200, replace=False))
    rows = np.concatenate([[0], rows[np.diff(rows, prepend=-100) > 5]])
    roll, pitch, yaw, heave = (x[rows] for x in (known.roll, known.pitch, known.yaw, known.heave))
    motion = replayed(known.t[rows], roll, pitch, yaw, heave, 100.0, "log")
    at = rows[rows < len(motion)]
    assert motion.roll[at] == pytest.approx(known.roll[at], abs=1e-9)
    assert motion.heave[at] == pytest.approx(known.heave[at], abs=1e-9)


def test_yaw_goes_on_across_a_turn():
    t = np.arange(60.0)
    yaw = np.deg2rad(170 + 0.5 * t)
    jumping = (yaw + np.pi) % (2 * np.pi) - np.pi
    motion = replayed(t, 0 * t, 0 * t, jumping, None, 10.0, "log")
    assert motion.angle_rates[:, 2] == pytest.approx(np.deg2rad(0.5))
    assert motion.angular_rate[:, 2] == pytest.approx(np.deg2rad(0.5))
    assert not motion.position.any()


def test_a_bad_log_is_refused():
    t = np.arange(60.0)

    def refused(t, roll, *words):
        with pytest.raises(InputError) as error:
            replayed(t, roll, 0 * t, 0 * t, None, 10.0, "palmer.log")
        for word in ("palmer.log", *words):
            assert word in str(error.value)

    refused(t[:9], t[:9], "9 samples", "at least 10")
    refused(t, np.where(t == 4, np.nan, 0.0), "sample 5", "no finite number")
    refused(np.where(t == 20, 18.5, t), 0 * t, "sample 21", "18.5", "increase")
    refused(np.where(t > 30, t + 2, t), 0 * t, "sample 32", "3 s after 30 s", "2.5 s")


def psxn(file) -> np.ndarray:
    """(n, 5) of a real log: t [s], and as the sentence has them roll, pitch, heading [deg], heave [m]."""
    rows = []
    for line in file.read_text(errors="replace").splitlines():
        stamp, _, sentence = line.partition(" ")
        if sentence.startswith("$PSXN,23,"):
            values = sentence.split("*")[0].split(",")[2:6]
            rows.append([datetime.fromisoformat(stamp.replace("Z", "+00:00")).timestamp(), *map(float, values)])
    return np.array(rows)


@pytest.fixture(scope="module")
def palmer(shared_data):
    """Two sensors' logs of one ship, as motions of 100 Hz, and the first as it is.

    Seapath: roll positive port up, pitch bow up, heave downwards, heading clockwise.
    """
    logs = [psxn(shared_data / "nbp1406_ship_motion" / f"NBP1406_{n}-2014-08-01") for n in ("s330", "seap")]
    motions = []
    for log in logs:
        t, roll, pitch, heading, heave = log.T
        motions.append(replayed(t, roll * DEG, -pitch * DEG, -heading * DEG, -heave, 100.0, "log"))
    return motions, logs


def test_a_real_ships_log_is_replayed(palmer):
    """RVIB Nathaniel B. Palmer, 625 s: the statistics of the log, and NMEA's angles back."""
    (motion, _), (log, _) = palmer
    assert len(motion) == pytest.approx(62400, abs=2)
    rms = np.std([motion.roll / DEG, motion.pitch / DEG], axis=1)
    assert rms == pytest.approx([0.58, 1.86], rel=0.02)
    assert motion.heave.std() == pytest.approx(1.12, rel=0.02)
    nmea = motion.nmea_deg()
    at = np.round(100 * (log[:, 0] - log[0, 0])).astype(int)
    still = np.abs(log[:, 0] - log[0, 0] - at / 100) < 0.0006
    assert nmea[at[still], :2] == pytest.approx(log[still, 1:3], abs=0.02)
    assert nmea[at[still], 2] == pytest.approx(log[still, 3], abs=0.02)


def test_two_sensors_have_one_motion(palmer):
    """Rates and heave accelerations of the replays agree as far as their rounding lets them."""
    (one, other), (log, second) = palmer
    shift = round(100 * (second[0, 0] - log[0, 0]))
    n = min(len(one) - max(shift, 0), len(other) + min(shift, 0))
    rates = [m.angle_rates[k : k + n, :2][500:-500] / DEG for m, k in ((one, max(shift, 0)), (other, max(-shift, 0)))]
    best = min(
        np.sqrt(np.mean((rates[0][100:-100] - np.roll(rates[1], lag, axis=0)[100:-100]) ** 2))
        for lag in range(-80, 81, 2)
    )
    assert best < 0.15 * np.sqrt(np.mean(rates[0] ** 2))


def test_heave_of_the_log_points_down(palmer, shared_data):
    """The height of the satellite antenna goes up when the sentence's heave goes down."""
    _, (log, _) = palmer
    heights = []
    for line in (
        (shared_data / "nbp1406_ship_motion" / "NBP1406_s330-2014-08-01").read_text(errors="replace").splitlines()
    ):
        stamp, _, sentence = line.partition(" ")
        if sentence.startswith("$INGGA,"):
            t = datetime.fromisoformat(stamp.replace("Z", "+00:00")).timestamp()
            heights.append([t, float(sentence.split(",")[9])])
    t, height = np.array(heights).T
    assert np.corrcoef(np.interp(log[:, 0], t, height), log[:, 4])[0, 1] < -0.8
