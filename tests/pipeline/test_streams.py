"""Raw streams through a whole run: from files as from the virtual robot, and what they cost against perfect means."""

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from identification.error_model import ErrorModel
from pipeline.virtual_robot import VirtualRobot
from urdf.kinematics import inverse
from urdf.workspace import sample

POSES = ("plan.poses=40", 'measure.channels=["tilt", "yaw"]')
GEOMETRIC_ALONE = ("measure.errors.elastic=false", "measure.errors.screw=false")
JOINTS = ["leg1_slide", "leg2_slide", "leg3_slide"]
ANGLES = ["roll", "pitch", "yaw"]


@pytest.fixture(scope="session")
def store(tmp_path_factory):
    return tmp_path_factory.mktemp("streams") / "store"


@pytest.fixture(scope="session")
def measured(start, store):
    """measured(*overrides): what the virtual robot measured in a run of 40 poses."""
    return lambda *overrides: start(store, *POSES, *overrides)[0].until("measure")[0]


@pytest.fixture
def from_files(start, store, tmp_path):
    """from_files(table, stream, *overrides): a run of ups3_s that reads these."""

    def run(table: pd.DataFrame, stream: pd.DataFrame | None, *overrides: str, suffix: str = "csv"):
        settings = []
        for name, frame in (("table", table), ("streams", stream)):
            if frame is not None:
                file = tmp_path / f"{name}.{suffix}"
                frame.to_parquet(file) if suffix == "parquet" else frame.to_csv(file, index=False)
                settings.append(f'measure.{name}="{file}"')
        return start(store, 'measure.source="files"', *settings, *overrides)[0]

    return run


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_files_give_what_the_virtual_run_gave(start, store, measured, from_files, suffix):
    """The exported table of joints and stream file, read back, filter to the same table to the last bit."""
    virtual = measured()
    expected = start(store, *POSES)[0].until("filter")[0]
    found = from_files(virtual.table, virtual.stream, suffix=suffix).until("filter")[0]
    pd.testing.assert_frame_equal(found.table, expected.table, check_dtype=False, check_exact=True)
    assert (found.used, found.gated) == (expected.used, expected.gated)
    assert found.used + found.gated == len(virtual.stream)


def test_the_table_in_another_order(start, store, measured, from_files):
    """Poses shuffled in the table, their stretches in the stream as they came: each pose keeps its own attitude."""
    virtual = measured()
    expected = start(store, *POSES)[0].until("filter")[0].table.set_index("pose")
    found = from_files(virtual.table[::-1], virtual.stream).until("filter")[0].table
    assert found["pose"].tolist() == virtual.table["pose"].tolist()[::-1]
    pd.testing.assert_frame_equal(found.set_index("pose").sort_index(), expected, check_dtype=False, check_exact=True)


def test_foreign_columns(measured, from_files, start, store):
    """Degrees and other names, mapped in robot.toml: the same attitudes."""
    virtual = measured()
    expected = start(store, *POSES)[0].until("filter")[0].table
    foreign = virtual.stream.rename(columns={"roll": "incl_x"}).assign(incl_x=np.rad2deg(virtual.stream["roll"]))
    table = virtual.table.rename(columns={"leg1_slide": "L1"}).assign(L1=1e3 * virtual.table["leg1_slide"])
    columns = 'measure.columns={roll = {from = "incl_x", unit = "deg"}, leg1_slide = {from = "L1", unit = "mm"}}'
    found = from_files(table, foreign, columns).until("filter")[0].table
    pd.testing.assert_frame_equal(found, expected, check_dtype=False, rtol=1e-9, atol=1e-12)


def scored(run, truth, p: np.ndarray) -> float:
    """Mean orientation error [deg] of a robot identified as p, on 500 poses of the noise-free truth."""
    description = run.robot.description
    errors = ErrorModel.of(run.until("model")[0].chain(), description.actuator, description.tolerance)
    chain = errors.chain
    closure = inverse(chain, sample(description.workspace, chain.tool_axes, 500, 98))
    readings = errors.actuators.readings(closure.q[:, chain.actuated])
    robot = errors.robot(p)
    true = Rotation.from_matrix(VirtualRobot.of(errors, truth).pose(readings).rotation)
    found = Rotation.from_matrix(robot.measured(robot.close(readings).pose).rotation)
    return float(np.rad2deg((true.inv() * found).magnitude()).mean())


def means(run, virtual) -> pd.DataFrame:
    """The table that perfect knowledge of outliers would give: means of each pose's good samples, and their sigmas."""
    description = run.robot.description
    errors = ErrorModel.of(run.until("model")[0].chain(), description.actuator, description.tolerance)
    true = VirtualRobot.of(errors, virtual.truth).pose(virtual.table[JOINTS].to_numpy())
    angles = Rotation.from_matrix(true.rotation).as_euler("ZYX")[:, ::-1]
    samples = virtual.stream[ANGLES].to_numpy() - angles[virtual.stream["pose"]]
    good = pd.DataFrame(samples, columns=ANGLES).mask(np.abs(samples) > np.deg2rad(0.5))
    assert 0.01 < good.isna().to_numpy().any(axis=1).mean() < 0.04
    good = good.groupby(virtual.stream["pose"]).mean() + angles
    sigma = np.deg2rad(0.01) / np.sqrt(245)
    return virtual.table.assign(**good, tilt_std=sigma, yaw_std=sigma)


@pytest.mark.parametrize("overrides", [(), GEOMETRIC_ALONE], ids=["all errors", "geometric alone"])
def test_streams_cost_little_accuracy(start, store, measured, from_files, overrides):
    """Raw streams against means that know the outliers: at most 20 % of accuracy, in the sum over two robots."""
    streams, perfect = 0.0, 0.0
    for seed in ("seed=0", "seed=1"):
        virtual = measured(seed, *overrides)
        raw = start(store, *POSES, seed, *overrides)[0]
        streams += scored(raw, virtual.truth, raw.until("identify")[0].shipped.change)
        table = from_files(means(raw, virtual), None, seed)
        perfect += scored(table, virtual.truth, table.until("identify")[0].shipped.change)
    assert perfect > 1e-4
    assert streams <= 1.2 * perfect
