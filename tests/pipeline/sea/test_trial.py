"""The sea trial: what is known in advance about its errors, and the command."""

import json

import numpy as np
import pandas as pd
import pytest

from kincal.pipeline.commands.app import main
from kincal.pipeline.methods.predictors import ModelMethod, uncalibrated
from kincal.pipeline.report.paper import HARDWARE
from kincal.pipeline.results import RAW
from kincal.pipeline.run.fingerprint import ROOT
from kincal.pipeline.sea import trial as trials
from kincal.pipeline.sea.configurations import configurations
from kincal.pipeline.sea.control import levelling
from kincal.pipeline.sea.settings import Seaway
from kincal.pipeline.sea.synthesis import generated, rao_of
from kincal.pipeline.sea.trial import START_S, Platform, Trial, deck_error, sea_trial
from kincal.pipeline.virtual.robot import STANDING, VirtualRobot, draw
from kincal.urdf.description import VirtualErrors
from kincal.urdf.rigid_motion import exp

PRINTED = ROOT.parents[1] / "shared" / "reference" / "xu2024_transfer_calibration.txt"
RATE = 20.0


@pytest.fixture(scope="module")
def built(robot):
    """(errors) -> a 3-UPS/S as built, and a platform whose identified model is the truth itself."""
    drawn = robot("ups3_s")

    def make(**errors):
        model = drawn.model
        truth = draw(model, VirtualErrors(**errors), 4)
        actual = VirtualRobot.of(model, truth)
        known = ModelMethod(actual.robot)
        methods = {RAW: uncalibrated(model), "nominal": known, "geometric": known}
        return Platform(drawn.description, model, actual, methods, ("tilt", "yaw"))

    return make


@pytest.fixture(scope="module")
def motion():
    sea = Seaway(minutes=START_S / 60 + 0.5, rate_hz=RATE, speed_knots=5.0)
    return generated(sea, rao_of(sea))


def test_a_model_without_error_leaves_what_the_filter_errs_by(built, motion):
    """Known robot, no delay, fast actuators: the deck errs by the filter's error, about the deck's own axes."""
    settings = Trial(delay_ms=0.0, bandwidth_hz=1e6)
    found = sea_trial(built(elastic=False, screw=False), motion, RATE, settings)
    known = found.methods[-1]
    assert np.abs(known.calibration).max() < 1e-9
    assert known.not_reached == 0
    assert np.abs(found.parts["load of a moving ship"]).max() < 1e-12
    few = slice(None, None, round(RATE / 10))
    np.testing.assert_allclose(known.error[few], found.parts["filter"], atol=1e-9)
    slope = found.filtered - found.ship[:, :2]
    assert np.linalg.norm(known.error, axis=1) == pytest.approx(np.linalg.norm(slope, axis=1), rel=2e-2)
    raw = found.methods[0]
    assert np.linalg.norm(raw.error, axis=1).mean() > 10 * np.linalg.norm(known.error, axis=1).mean()


def test_looking_ahead_undoes_delay_and_lag(built, motion):
    with_lead, without = (
        sea_trial(built(elastic=False, screw=False), motion, RATE, Trial(delay_ms=100.0, bandwidth_hz=2.0, lead=lead))
        for lead in (True, False)
    )
    late, ahead = (np.abs(t.parts["delay and actuators, looked ahead"][20:]).mean() for t in (without, with_lead))
    assert ahead < late / 10
    delay = np.linalg.norm(with_lead.parts["delay"], axis=1).mean()
    turning = np.linalg.norm(motion.angular_rate[round(START_S * RATE) :, :2], axis=1).mean()
    assert delay == pytest.approx(0.1 * turning, rel=0.02)  # rate times delay


def test_the_load_follows_the_specific_force(built):
    """Twice the weight, twice the deflection; and the payload's own weight where the ship stands still."""
    platform = built(geometric=False, screw=False, frame_rotation_deg=0.0, frame_translation_mm=0.0)
    home = platform.model.actuators.readings(platform.model.chain.home[None, platform.model.chain.actuated])
    rigid, once, twice = (platform.poses(home, f * STANDING) for f in (0.0, 1.0, 2.0))
    first, second = (np.linalg.norm(deck_error(rigid, deck, True)) for deck in (once, twice))
    assert first > 1e-7
    assert second == pytest.approx(2 * first, rel=1e-3)
    np.testing.assert_array_equal(once, platform.actual.pose(home, platform.actual.after_campaign(home)).rotation)
    aside = platform.poses(home, np.array([9.80665, 0.0, 0.0]))
    assert np.abs(deck_error(once, aside, True)).max() > 1e-7


def test_a_tool_with_two_axes_is_asked_for_the_decks_normal(robot):
    """2-UPS/U, its model without error: level but for the filter, though its heading follows the robot."""
    drawn = robot("ups2_u")
    truth = draw(drawn.model, VirtualErrors(elastic=False, screw=False, frame_rotation_deg=5.0), 3)
    actual = VirtualRobot.of(drawn.model, truth)
    known = ModelMethod(actual.robot)
    platform = Platform(drawn.description, drawn.model, actual, {"geometric": known}, ("tilt",))
    angles = np.deg2rad(np.random.default_rng(0).uniform(-8, 8, (40, 3)))
    level = levelling(angles, platform.level_yaw())
    readings, good = platform.commands(known, level)
    assert good.all()
    assert np.abs(deck_error(level, platform.poses(readings, STANDING), full=False)).max() < 1e-7


def test_only_tilt_counts_without_a_heading():
    level = exp(np.array([[0.1, -0.2, 0.3]]))
    turned = level @ exp(np.array([[0.0, 0.0, 0.05]]))
    tilted = level @ exp(np.array([[0.01, 0.0, 0.0]]))
    assert np.abs(deck_error(level, turned, full=False)).max() < 1e-12
    assert deck_error(level, turned, full=True)[0, 2] == pytest.approx(0.05)
    assert np.linalg.norm(deck_error(level, tilted, full=False)) == pytest.approx(0.01)


def test_a_platform_that_can_not_level_a_deck_is_refused(robot):
    for name, channels, said in (("linear_delta", ("position",), "turn about x and y"), ("ups3_s", ("yaw",), "tilt")):
        drawn = robot(name)
        truth = draw(drawn.model, VirtualErrors(), 0)
        platform = Platform(drawn.description, drawn.model, VirtualRobot.of(drawn.model, truth), {}, channels)
        with pytest.raises(trials.InputError, match=said):
            platform.check()


def test_a_sea_beyond_the_workspace_is_refused_or_counted(built):
    platform = built(elastic=False, screw=False)
    steep = exp(np.deg2rad([[0.0, 0.0, 0.0], [5.0, 0.0, 0.0], [70.0, 0.0, 0.0]]))
    readings, good = platform.commands(platform.methods["geometric"], steep)
    assert good.tolist() == [True, True, False]
    np.testing.assert_array_equal(readings[2], readings[1])  # the last command stands
    with pytest.raises(trials.InputError, match="outside"):
        platform.commands(platform.methods["geometric"], steep[[0, 2, 2]])


def test_configurations_by_a_model_without_error(built):
    platform = built(elastic=False, screw=False)
    model = platform.model
    chosen = model.actuators.readings(model.chain.home[model.chain.actuated] + np.linspace(-0.01, 0.01, 6)[:, None])
    found = configurations(platform, chosen, np.array([1, 4]))
    assert np.abs(found.errors["geometric"]).max() < 1e-9
    assert np.abs(found.tilted["geometric"]).max() < 1e-9
    assert np.linalg.norm(found.errors[RAW], axis=1).min() > 1e-3


@pytest.mark.skipif(not PRINTED.exists(), reason="the paper's text is not beside the project")
def test_the_papers_numbers_are_as_printed():
    text = PRINTED.read_text()
    for title, columns in (("Table 3.", slice(0, 3)), ("Table 4.", slice(3, 4))):
        lines = text[text.index(title + " Experimental") :].splitlines()
        for how, label in (("mean", "Mean"), ("max", "Maximum"), ("sd", "SD")):
            printed = next(line for line in lines if line.startswith(label)).split("\t")[1:]
            ours = [value for method in HARDWARE.values() for value in method[how][columns]]
            assert [float(cell) for cell in printed] == ours


def overriding(settings) -> list[str]:
    return [part for setting in settings for part in ("--set", setting)]


@pytest.fixture(scope="module")
def sailed(finished, tmp_path_factory):
    folder = tmp_path_factory.mktemp("sea") / "trial"
    arguments = ["--minutes", "0.1", "--rate-hz", "20", "--output", folder, "--store", finished.store]
    with pytest.raises(SystemExit) as left:
        main(["sea-trial", "ups3_s", *map(str, arguments), *overriding(finished.settings)])
    assert left.value.code == 0
    return folder


def test_the_command_writes_page_document_and_series(sailed):
    folder = sailed
    found = json.loads((folder / "results.json").read_text())
    names = [row["method"] for row in found["deck_error"]]
    assert names == [RAW, "nominal", "geometric", "network", "transfer", "transfer_identified", "hybrid"]
    table = pd.read_parquet(folder / "series.parquet")
    assert len(table) == 120
    size = np.linalg.norm(table[[f"hybrid_{axis}_deg" for axis in "xyz"]].to_numpy(float), axis=1)
    told = found["deck_error"][-1]
    assert told["mean_deg"]["volumetric"] == pytest.approx(size.mean(), rel=1e-5)
    assert told["max_deg"]["volumetric"] == pytest.approx(size.max(), rel=1e-5)
    html = (folder / "index.html").read_text()
    assert "Tables 3 and 4" in html
    for figure in ("deck", "ship", "figure13", "figure14", "figure15"):
        assert (folder / f"{figure}.svg").stat().st_size > 1000
        assert f'id="{figure}-' in html


def test_a_recorded_motion_is_replayed(cli, finished, tmp_path):
    """A log of a known motion, NMEA's signs in CSV's place: kincal's own axes."""
    t = np.arange(0, 140, 0.5)
    roll = np.deg2rad(3.0) * np.sin(2 * np.pi * t / 9)
    log = tmp_path / "motion.csv"
    pd.DataFrame({"t": t, "roll": roll, "pitch": 0.3 * roll}).to_csv(log, index=False)
    arguments = ["--motion", log, "--rate-hz", "20", "--output", tmp_path / "out"]
    answer = cli("sea-trial", "ups3_s", *arguments, "--store", finished.store, *overriding(finished.settings))
    assert answer.status == 0, answer.err
    assert "table 4" in answer.out
    assert "all together" in answer.out
    found = json.loads((tmp_path / "out" / "results.json").read_text())["motion"]
    assert found["seconds"] == pytest.approx(19.55, abs=0.1)
    table = pd.read_parquet(tmp_path / "out" / "series.parquet")
    expected = 3.0 * np.sin(2 * np.pi * (table["t"] + START_S) / 9)
    np.testing.assert_allclose(table["ship_roll_deg"], expected, atol=2e-3)


@pytest.mark.parametrize(
    "arguments, said",
    [
        (["--sea-state", "7"], ["sea_state", "3, 4, 5 or 6"]),
        (["--minutes", "0"], ["minutes"]),
        (["--minutes", "1000"], ["--minutes", "60"]),
        (["--sensor", "mrru"], ["mrru", "mru"]),
        (["--rao", "nowhere.csv"], ["nowhere.csv"]),
        (["--motion", "nowhere.log"], ["nowhere.log"]),
        (["--delay-ms", "-1"], ["delay_ms"]),
    ],
)
def test_bad_options(cli, finished, arguments, said):
    answer = cli("sea-trial", "ups3_s", *arguments, "--store", finished.store, *overriding(finished.settings))
    assert answer.status == 2, answer
    assert "Traceback" not in answer.err
    last = answer.err.strip().splitlines()[-1]
    for text in said:
        assert text in last
