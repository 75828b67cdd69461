"""A real Stewart platform: 108 poses by motion capture, against the reference fits that came with the recording."""

from __future__ import annotations

import numpy as np
import pytest

from kincal.identification.estimators import estimate_parameters, register
from kincal.identification.measurement_table import read_table
from kincal.identification.measurements import to_measurements
from kincal.identification.summary import summarise


@pytest.fixture(scope="module")
def measured(robot, shared_data):
    loaded = robot("jugglebot")
    file = shared_data / "jugglebot" / "calibration_108.csv"
    table = read_table(file, loaded.chain.actuated_names, loaded.description.measure)
    return to_measurements(table, loaded.chain.actuated_names, loaded.description.sensor)


def test_identified_robot_fits_the_recording(robot, measured):
    """README: 48 parameters by least squares leave 0.95 mm and 0.165 degrees in pose, 0.41 mm in leg length."""
    loaded = robot("jugglebot")
    found = summarise(
        loaded.model, measured, estimate_parameters(loaded.model, measured), register(loaded.model, measured)
    )
    assert found.n_poses == 108
    assert found.channels == ("orientation", "position")
    assert found.residual_size["position_mm"] <= 1.0
    assert found.residual_size["orientation_deg"] <= 0.17
    assert found.residual_size["prismatic_mm"] <= 0.60
    priors = np.isfinite(found.tolerance)
    placements = priors & np.array([not name.endswith((".zero", ".gain")) for name in found.names])
    assert placements.sum() > 150
    assert np.max(np.abs(found.change / found.tolerance)[placements]) <= 4


def test_frames_alone_leave_what_the_drawing_lacks(robot, measured):
    """README: frames and leg zeros leave 1.3-1.6 mm in leg length; frames alone can't leave less."""
    loaded = robot("jugglebot")
    found = summarise(loaded.model, measured, register(loaded.model, measured), register(loaded.model, measured))
    assert found.residual_size["prismatic_mm"] > 1.3
    assert found.residual_size["position_mm"] > 1.0
