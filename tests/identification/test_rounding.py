"""Numbers that are coarser than the sensor's sigma are named, with the size of their step."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from kincal.identification.measurements import to_measurements, to_table
from kincal.identification.rounding import rounding_finding
from kincal.urdf.description import Sensor


@pytest.mark.parametrize("name", ["ur10", "rps3", "gough_stewart"])
@pytest.mark.parametrize(
    "decimals, unit, sigma_mm, words",
    [(3, 1.0, 0.03, "steps of 1 mm"), (1, 1e3, 0.01, "steps of 0.1 mm"), (3, 1.0, 0.5, None), (6, 1.0, 0.03, None)],
)
def test_positions(name, decimals, unit, sigma_mm, words, robot):
    loaded = robot(name)
    readings = loaded.readings(12, 3)
    measured = loaded.measure(loaded.random_parameters(3), readings, ("position",), {}, np.random.default_rng(1))
    position = np.round(measured.values["position"] * unit, decimals) / unit
    table = to_table(loaded.chain.actuated_names, readings, dict(zip("xyz", position.T, strict=True)))
    poses = to_measurements(table, loaded.chain.actuated_names, Sensor(position_mm=sigma_mm))
    finding = rounding_finding(pd.DataFrame(table), poses)
    assert (words in finding) if words else finding == ""
    if words:
        assert f"their sigma of {sigma_mm:g} mm: write more digits" in finding


def test_orientations_by_their_angle(robot):
    """Three decimals of a quaternion near the identity are 0.002 rad: 0.11 degrees."""
    loaded = robot("ups3_s")
    readings = loaded.readings(12, 3)
    measured = loaded.measure(loaded.random_parameters(3), readings, ("orientation",), {}, np.random.default_rng(1))
    from kincal.identification.channels import named

    (channel,) = named(measured.channels)
    columns = {k: np.round(v, 3) for k, v in channel.write(measured.values["orientation"]).items()}
    table = to_table(loaded.chain.actuated_names, readings, columns)
    poses = to_measurements(table, loaded.chain.actuated_names, Sensor(orientation_deg=0.006))
    assert rounding_finding(pd.DataFrame(table), poses) == (
        "qx, qy, qz, qw are rounded to steps of 0.11 deg, coarser than their sigma of 0.006 deg: write more digits"
    )
