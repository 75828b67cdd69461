"""Logs and command logs with time as others write it: the same poses, and the clocks' offset as it was made."""

import numpy as np
import pandas as pd
import pytest

from kincal.identification.streams.static_poses import static_poses
from kincal.urdf.description import Measure
from kincal.urdf.errors import InputError

JOINTS = ("a", "b", "c")
EPOCH = 1767225600.0  # 2026-01-01


@pytest.fixture(scope="module")
def schedule(campaigns):
    joints = np.random.default_rng(5).uniform(-0.1, 0.1, (12, 3))
    return campaigns(joints, offset=3.5)


def poses(schedule, folder, log, commands=lambda table: table, **measure):
    log(schedule.log.assign(t=schedule.log["t"] - 3.5)).to_csv(folder / "log.csv", index=False)
    commands(schedule.commands).to_csv(folder / "commands.csv", index=False)
    settings = {"streams": folder / "log.csv", "commands": folder / "commands.csv"}
    return static_poses(Measure.model_validate(settings | measure), JOINTS)


def stamps(table, pattern):
    moments = pd.to_datetime(EPOCH + 3.5 + table["t"], unit="s")
    return moments.dt.strftime(pattern).str[:-3]  # milliseconds


def split(table):
    day = stamps(table, "%d.%m.%Y %H:%M:%S.%f").str.split(" ", expand=True)
    return table.drop(columns="t").assign(Date=day[0], Time=day[1])


def scaled(factor):
    return lambda table: table.assign(t=(factor * (EPOCH + 3.5 + table["t"])).round().astype("int64"))


WRITTEN = {
    "german": (lambda table: table.assign(t=stamps(table, "%d.%m.%Y %H:%M:%S.%f")), EPOCH),
    "time of day": (lambda table: table.assign(t=stamps(table, "%H:%M:%S.%f")), 0.0),
    "two columns": (split, EPOCH),
    "ms": (scaled(1e3), EPOCH),
    "us": (scaled(1e6), EPOCH),
    "ns": (scaled(1e9), EPOCH),
}


@pytest.mark.parametrize("name", WRITTEN)
def test_the_poses_of_a_log(name, schedule, tmp_path):
    write, start = WRITTEN[name]
    found = poses(schedule, tmp_path, write)
    assert len(found.table) == 12
    assert found.campaign.offset is not None
    assert found.campaign.offset.seconds == pytest.approx(start + 3.5, abs=0.3)
    assert found.campaign.health.bad == 0


@pytest.mark.parametrize("name", WRITTEN)
def test_commands_as_well(name, schedule, tmp_path):
    write, _ = WRITTEN[name]
    found = poses(schedule, tmp_path, write, write)
    assert len(found.table) == 12
    assert found.campaign.offset is not None
    assert found.campaign.offset.seconds == pytest.approx(0.0, abs=0.3)


def test_columns_by_a_map(schedule, tmp_path):
    def renamed(table):
        return split(table).rename(columns={"Date": "Datum", "Time": "Uhrzeit"})

    found = poses(schedule, tmp_path, renamed, columns={"t": "Uhrzeit", "date": "Datum"})
    assert found.campaign.offset is not None
    assert found.campaign.offset.seconds == pytest.approx(EPOCH + 3.5, abs=0.3)
    ticks = poses(  # nanoseconds since the start: no size tells
        schedule,
        tmp_path,
        lambda table: table.assign(t=(1e9 * table["t"]).astype("int64")),
        lambda table: table.assign(t=1e9 * table["t"]),
        columns={"t": {"from": "t", "unit": "ns"}},
    )
    assert ticks.campaign.offset is not None
    assert ticks.campaign.offset.seconds == pytest.approx(0.0, abs=0.3)


def test_other_formats_are_refused_with_those_that_are_allowed(schedule, tmp_path):
    with pytest.raises(InputError, match=r"log\.csv: column 't': found '01/01/2026.*allowed are.*31\.01\.2026 09:33"):
        poses(schedule, tmp_path, lambda table: table.assign(t=stamps(table, "%m/%d/%Y %H:%M:%S.%f")))
    with pytest.raises(InputError, match=r"commands\.csv: column 't', row 1: found '01/01/2026.*31\.01\.2026 09:33"):
        poses(
            schedule,
            tmp_path,
            lambda table: table,
            lambda table: table.assign(t=stamps(table, "%m/%d/%Y %H:%M:%S.%f")),
        )


@pytest.mark.parametrize(("factor", "unit"), [(1e3, "ms"), (1e6, "us"), (1e9, "ns")])
def test_ticks_since_the_start_are_named(factor, unit, schedule, tmp_path):
    with pytest.raises(InputError, match=rf"the log in {unit}\? .*from = \"t_{unit}\""):
        poses(schedule, tmp_path, lambda table: table.assign(t=(factor * table["t"]).astype("int64")))
