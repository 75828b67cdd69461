"""`kincal run` on a sensor's log without a pose column and a command log: NMEA, a ROS 2 bag and CSV."""

import numpy as np
import pandas as pd
import pytest

from benchmarks import samples
from benchmarks.samples import JOINTS, OFFSET_S, as_bag, as_nmea
from kincal.pipeline.results import Filtered
from kincal.pipeline.stages.registry import STAGES
from kincal.urdf.description import load_robot
from kincal.urdf.errors import InputError

POSES, RATE, NOISE_DEG = 14, 20.0, 0.01


@pytest.fixture(scope="session")
def store(tmp_path_factory):
    return tmp_path_factory.mktemp("campaign") / "store"


@pytest.fixture(scope="session")
def virtual(start, store):
    """A virtual robot's table, without noise: roll, pitch as the sensor would read them."""
    tracker = 'measure.channels=["orientation"]', "sensor.orientation_deg=1e-9"
    table = start(store, f"plan.poses={POSES}", 'plan.layout="random"', *tracker)[0].until("measure")[0].table
    return samples.tilts(table)


@pytest.fixture(scope="session")
def campaign(virtual) -> tuple[pd.DataFrame, pd.DataFrame]:
    """The log (t, roll, pitch) of a sensor on the robot as it went through its poses, and the commands' log.

    Pose 5 is left after a second.
    """
    held = np.random.default_rng(3).uniform(5.0, 7.0, POSES)
    held[5] = 1.0
    return samples.campaign(virtual, held, RATE, NOISE_DEG)


@pytest.mark.parametrize("write", samples.FORMATS)
def test_poses_from_a_log(write, start, store, virtual, campaign, tmp_path):
    """Against the true attitudes: every pose but the short one, as true as its noise allows; the faults are told."""
    log, commands = campaign
    commands.to_csv(tmp_path / "commands.csv", index=False)
    files = f'measure.streams="{write(log, tmp_path)}"', f'measure.commands="{tmp_path / "commands.csv"}"'
    run, events = start(store, 'measure.source="files"', *files)
    measured, filtered = run.until("measure", "filter")
    assert isinstance(filtered, Filtered)
    table = filtered.table.set_index("pose")
    assert table.index.tolist() == [k for k in range(POSES) if k != 5]
    np.testing.assert_array_equal(table[JOINTS], virtual.loc[table.index, JOINTS])
    error = np.rad2deg(table[["roll", "pitch"]].to_numpy() - virtual.loc[table.index, ["roll", "pitch"]].to_numpy())
    assert np.abs(error).max() < 4 * NOISE_DEG / np.sqrt(2 * RATE)
    assert measured.campaign.offset.seconds == pytest.approx(OFFSET_S, abs=0.3)
    assert [d.pose for d in measured.campaign.dropped] == [5]
    said = [event.why for event in events if event.state == "noted"]
    assert any(line.startswith("pose 5 was left out: held for 2.5 s") for line in said)
    if write is as_nmea:
        spoiled = len(range(7, len(log), 50))
        assert f"log.nmea: {spoiled} of {len(log)} records fail their checksum" in said
        assert measured.campaign.health.checksum == spoiled


def test_skipped_poses_of_a_log(start, store, campaign, tmp_path):
    """By the numbers of the command log, also of a pose that was dropped already."""
    log, commands = campaign
    commands.to_csv(tmp_path / "commands.csv", index=False)
    files = f'measure.streams="{as_nmea(log, tmp_path)}"', f'measure.commands="{tmp_path / "commands.csv"}"'
    run, _ = start(store, 'measure.source="files"', *files, "measure.skip=[3, 5]")
    measured, filtered = run.until("measure", "filter")
    assert filtered.table["pose"].tolist() == [k for k in range(POSES) if k not in (3, 5)]
    assert any("poses 3, 5: left out by measure.skip" in note for note in measured.notes)
    run, _ = start(store, 'measure.source="files"', *files, "measure.skip=[99]")
    with pytest.raises(InputError, match=r"measure\.skip: no pose 99; allowed are 0 to"):
        run.until("measure")


def test_what_the_files_hold_is_part_of_the_key(start, store, campaign, tmp_path):
    """Another byte in a bag's folder or in the command log: the poses are found anew; else they are not."""
    log, commands = campaign
    commands.to_csv(tmp_path / "commands.csv", index=False)
    bag = as_bag(log, tmp_path)
    files = f'measure.streams="{bag}"', f'measure.commands="{tmp_path / "commands.csv"}"'

    def state() -> str:
        run, events = start(store, 'measure.source="files"', *files)
        run.until("measure")
        return next(e.why or e.state for e in events if e.stage == "measure" and e.state in ("ran", "cached"))

    state()
    assert state() == "cached"
    commands.assign(t=commands["t"] + 1.0).to_csv(tmp_path / "commands.csv", index=False)
    assert "measure.commands" in state()
    (bag / "note.txt").write_text("deck crane moved at noon")
    assert "measure.streams" in state()


def test_the_page_tells_of_the_log(start, store, campaign, tmp_path):
    """Health, offset and the pose that was left out, as the report's template shows them."""
    from jinja2 import Environment

    from kincal.pipeline.run.fingerprint import ROOT

    log, commands = campaign
    commands.to_csv(tmp_path / "commands.csv", index=False)
    files = f'measure.streams="{as_nmea(log, tmp_path)}"', f'measure.commands="{tmp_path / "commands.csv"}"'
    measured, filtered = start(store, 'measure.source="files"', *files)[0].until("measure", "filter")
    text = (ROOT / "kincal" / "pipeline" / "report" / "templates" / "page.html").read_text()
    part = text[text.index("{% set dropped") : text.index("<h2>Learned correction")]
    page = Environment(autoescape=True).from_string(part).render(campaign=measured.campaign, filtered=filtered)
    assert "13 of 14 commanded poses were used" in page
    assert "fail their checksum" in page
    assert "pose 5: held for 2.5 s" in page


@pytest.mark.parametrize(
    "settings, said",
    [
        (['measure.commands="c.csv"'], "commands need the stream that was logged beside them: set measure.streams"),
        (['measure.commands="c.csv"', 'measure.table="t.csv"'], "commands and table both give the joint values"),
        (['measure.streams="s.log"'], "set measure.table or measure.commands"),
        (['measure.log.formt="nmea"'], "did you mean 'format'?"),
        (["measure.log.min_seconds=0"], "measure.log.min_seconds: found 0"),
    ],
)
def test_settings_that_don_t_fit_are_refused(settings, said):
    with pytest.raises(InputError, match=r"ups3_s|--set") as error:
        load_robot("ups3_s", settings)
    assert said in str(error.value)


def test_a_log_without_commands_is_refused(start, store, virtual, campaign, tmp_path):
    virtual[["pose", *JOINTS]].to_csv(tmp_path / "joints.csv", index=False)
    files = f'measure.streams="{as_nmea(campaign[0], tmp_path)}"', f'measure.table="{tmp_path / "joints.csv"}"'
    with pytest.raises(InputError, match=r"log\.nmea: a nmea log does not say which pose .* set measure\.commands"):
        start(store, 'measure.source="files"', *files)[0].until("measure")


def test_the_readers_libraries_are_part_of_the_key():
    libraries = STAGES["measure"][1]
    assert {"pynmeagps", "rosbags"} <= set(libraries)
