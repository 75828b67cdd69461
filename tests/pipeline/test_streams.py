"""Raw streams through a whole run: from files as from the virtual robot, and what they cost against perfect means."""

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from kincal.identification.error_model import ErrorModel
from kincal.pipeline.virtual.robot import VirtualRobot
from kincal.urdf.kinematics import inverse
from kincal.urdf.workspace import sample

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


def test_damage_is_survived_and_told(cli, start, store, measured, tmp_path):
    """Through `kincal run`: against the run on the same files without what was damaged, and the counts on stderr."""
    virtual = measured()
    stream = virtual.stream.astype({"pose": float})
    rows = stream.groupby("pose").cumcount().to_numpy()
    pose = stream["pose"].to_numpy()
    clean = stream[~((pose == 3) & (rows == 9)) & ~((pose == 4) & (rows == 20)) & ~np.isin(pose, [5, 6])]
    stream.loc[(pose == 3) & (rows == 9), "roll"] = np.nan
    stream.loc[(pose == 4) & (rows == 20), "t"] += 5e3
    stream.loc[pose == 5, "pitch"] = 0.125
    tables = {}
    virtual.table.to_csv(tmp_path / "joints.csv", index=False)
    for name, frame in (("damaged", stream[pose != 6]), ("clean", clean)):
        frame.to_csv(tmp_path / f"{name}.csv", index=False)
        files = (f'measure.table="{tmp_path / "joints.csv"}"', f'measure.streams="{tmp_path / name}.csv"')
        settings = ('measure.source="files"', *files)
        arguments = [part for setting in settings for part in ("--set", setting)]
        answer = cli("run", "ups3_s", "--store", store, "--until", "filter", *arguments)
        assert answer.status == 0, answer.err
        if name == "damaged":
            for said in (
                f"damaged.csv: 1 of {len(frame)} records have no number for t, roll or pitch",
                f"damaged.csv: 1 of {len(frame)} records have a time far ahead that the next ones deny",
                f"damaged.csv: channel 'pitch' is stuck for {np.sum(pose == 5)} samples",
                "pose 5 was left out: channel 'pitch' is stuck at 7.16197 degrees",
                "pose 6 was left out: it has no sample; allowed is at least 5",
            ):
                assert said in answer.err
        tables[name] = start(store, *settings)[0].until("filter")[0].table
    pd.testing.assert_frame_equal(tables["damaged"], tables["clean"], check_exact=True)
    assert len(tables["clean"]) == 38


def test_the_page_tells_of_the_stream(measured, from_files):
    """What is wrong with a stream, and the poses that were left out, as the report's template shows them."""
    from jinja2 import Environment

    from kincal.pipeline.run.fingerprint import ROOT

    virtual = measured()
    stream = virtual.stream.assign(roll=virtual.stream["roll"].mask(virtual.stream["pose"] == 7, 0.125))
    stream.loc[3, "t"] = np.nan
    found, filtered = from_files(virtual.table, stream).until("measure", "filter")
    text = (ROOT / "kincal" / "pipeline" / "report" / "templates" / "page.html").read_text()
    part = text[text.index("{% set dropped") : text.index("<h2>Learned correction")]
    report = Environment(autoescape=True).from_string(part).render(campaign=found.campaign, filtered=filtered)
    assert f"streams.csv (csv): {len(stream) - 1} good samples, for 40 poses." in report
    assert f"1 of {len(stream)} records have no number for t, roll or pitch." in report
    assert "Skipped commanded poses: 1" in report
    assert "pose 7: channel &#39;roll&#39; is stuck at 7.16197 degrees" in report


def test_a_stream_of_half_the_poses_is_refused(cli, store, measured, tmp_path):
    virtual = measured()
    virtual.table.to_csv(tmp_path / "joints.csv", index=False)
    virtual.stream[virtual.stream["pose"] % 2 == 0].to_csv(tmp_path / "stream.csv", index=False)
    files = (
        "measure.source=files",
        f"measure.table={tmp_path / 'joints.csv'}",
        f"measure.streams={tmp_path / 'stream.csv'}",
    )
    answer = cli("run", "ups3_s", "--store", store, *(part for file in files for part in ("--set", file)))
    assert answer.status == 2
    assert (
        "stream.csv): 20 of 40 poses can't be used; allowed are fewer than half; the first is pose 1: it has no "
        in (answer.err)
    )


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
