"""Generated ship motion beside waveresponse's statistics, the closed forms beside a strip-theory table, and the replay.

A minute. The supply ship's table is read from the data sets beside the project, where they are at hand.
"""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from benchmarks.timing import median_seconds, row
from kincal.pipeline.sea.replay import replayed
from kincal.pipeline.sea.response import expected_std
from kincal.pipeline.sea.settings import SEA_STATES, Seaway
from kincal.pipeline.sea.ship_motion import ShipMotion
from kincal.pipeline.sea.synthesis import generated, rao_of

TABLE = Path(__file__).parents[2] / "shared" / "data" / "mss_supply_vessel" / "supply.mat"
RECORDS = 20
UNITS = np.array([1, 1, 1, *[180 / np.pi] * 3])
HEAD = "surge  sway heave [m]  roll pitch  yaw [deg]"


def main() -> None:
    tables = {"supply ship's table": TABLE} if TABLE.is_file() else {}
    print(f"standard deviations, waveresponse's, and by how much the mean of {RECORDS} records of 3 hours differs")
    print(f"{'':<52}{HEAD}")
    for settings in (*({"sea_state": s} for s in SEA_STATES), {"spreading": 1}, {"speed_knots": 12.0}):
        statistics(Seaway(minutes=180, rate_hz=1, **settings), f"closed forms, {described(settings)}")
    for what, file in tables.items():
        statistics(Seaway(minutes=180, rate_hz=1, rao=file), f"{what}, {described({'sea_state': 5})}")
        print(f"\nby heading, sea state 5: the closed forms, and {what}\n{'':<52}{HEAD}")
        for heading in range(0, 181, 30):
            for source, rao in (("closed forms", None), (what, file)):
                sea = Seaway(heading_deg=float(heading), rao=rao)
                show(f"{heading:>3} degrees, {source}", expected_std(sea, rao_of(sea)))
    print()
    sea = Seaway()
    row("ten minutes at 100 Hz", median_seconds(lambda: generated(sea, rao_of(sea)), runs=3))
    replay(generated(sea, rao_of(sea)))


def described(settings: dict) -> str:
    sea = Seaway(**settings)
    spread = f", cos^{2 * sea.spreading}" if sea.spreading else ""
    return f"sea state {sea.sea_state}, {sea.heading_deg:g} deg, {sea.speed_knots:g} kn{spread}"


def show(what: str, std: np.ndarray) -> None:
    cells = " ".join(f"{value:5.2f}" for value in (std * UNITS)[:3])
    print(f"{what:<52}{cells}    {' '.join(f'{value:5.2f}' for value in (std * UNITS)[3:])}", flush=True)


def statistics(sea: Seaway, what: str) -> None:
    rao = rao_of(sea)
    expected = expected_std(sea, rao)
    show(what, expected)
    began, found = time.perf_counter(), []
    for seed in range(RECORDS):
        motion = generated(sea.model_copy(update={"seed": seed}), rao)
        found.append(np.concatenate([motion.position.std(axis=0), motion.angles.std(axis=0)]))
    seconds = time.perf_counter() - began
    apart = " ".join(f"{value:+5.1f}" for value in 100 * (np.mean(found, axis=0) / expected - 1))
    one = 100 * (np.std(found, axis=0) / expected).max()
    print(f"{f'  apart [%]; one record scatters by up to {one:.1f} %':<52}{apart}  {seconds:.1f} s", flush=True)


def replay(known: ShipMotion) -> None:
    """A log of 1 Hz with two decimals of degrees and metres, replayed at 100 Hz, against the motion itself."""
    columns = (known.roll * UNITS[3], known.pitch * UNITS[3], known.yaw * UNITS[3], known.heave)
    roll, pitch, yaw, heave = (np.round(c[::100], 2) for c in columns)
    roll, pitch, yaw = roll / UNITS[3], pitch / UNITS[3], yaw / UNITS[3]
    motion = replayed(known.t[::100], roll, pitch, yaw, heave, 100.0, "log")
    inner = slice(500, len(motion) - 500)

    def rms(name: str, column: slice) -> float:
        apart = getattr(motion, name)[inner, column] - getattr(known, name)[: len(motion)][inner, column]
        return float(np.sqrt(np.mean(apart**2)))

    print("replay of a log of 1 Hz, rounded to 0.01 degrees and 0.01 m; rms error (rms of the motion)")
    for name, unit, column, scale in (
        ("angles", "deg", slice(0, 3), UNITS[3]),
        ("angle_rates", "deg/s", slice(0, 3), UNITS[3]),
        ("angle_accelerations", "deg/s^2", slice(0, 3), UNITS[3]),
        ("position", "m", slice(2, 3), 1.0),
        ("acceleration", "m/s^2", slice(2, 3), 1.0),
    ):
        size = getattr(known, name)[:, column].std() * scale
        print(f"  {name:<22}{rms(name, column) * scale:8.4f} {unit} ({size:.2f})")


if __name__ == "__main__":
    main()
