"""`kincal sea-trial`: a robot's calibration, taken to sea."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from kincal.pipeline.methods.calibrated import calibrations
from kincal.pipeline.methods.predictors import uncalibrated
from kincal.pipeline.report.numbers import significant
from kincal.pipeline.report.pages import environment
from kincal.pipeline.report.paper import AXES
from kincal.pipeline.results import RAW
from kincal.pipeline.run.runner import Run
from kincal.pipeline.run.stage import version
from kincal.pipeline.sea.configurations import Configurations, configurations
from kincal.pipeline.sea.replay import replayed
from kincal.pipeline.sea.settings import Seaway
from kincal.pipeline.sea.ship_motion import ShipMotion
from kincal.pipeline.sea.synthesis import generated, rao_of
from kincal.pipeline.sea.trial import START_S, Platform, SeaTrial, Trial, sea_trial
from kincal.pipeline.sea.trial_document import document, series
from kincal.pipeline.stages.robot_data import Poses
from kincal.pipeline.store.files import replace_files
from kincal.pipeline.virtual.robot import VirtualRobot
from kincal.urdf.errors import InputError

MOST_MINUTES = 60.0  # memory, and patience


@dataclass(frozen=True)
class Found:
    """A trial, and all that is told of it."""

    trial: SeaTrial
    poses: Configurations
    document: dict[str, Any]


def sail(
    session: Run, sea: Seaway, settings: Trial, log: Path | None, command: str, begins: Callable[[], None]
) -> Found:
    """The trial of a calibrated robot, in a seaway or on a recorded motion. Raises InputError.

    begins: called when the calibration is at hand, and the trial begins.
    """
    if sea.minutes > MOST_MINUTES:
        raise InputError(f"--minutes {sea.minutes:g}: allowed are at most {MOST_MINUTES:g}")
    motion, sentence = _replay(log, sea) if log else _seaway(sea)
    model, measured, filtered, identified, transferred, hybrids = session.until(
        "model", "measure", "filter", "identify", "transfer", "correct"
    )
    description = session.robot.description
    if measured.truth is None:
        raise InputError(
            f"{description.name}: a sea trial moves the robot as it really is, which only a virtual robot knows: "
            f'measure.source is "files" ({measured.source}), allowed is "virtual"'
        )
    drawn = Poses.measured_on(model, filtered, description)
    errors, readings, actual = drawn.errors, drawn.measurements.readings, VirtualRobot.of(drawn.errors, measured.truth)
    platforms = [
        Platform(description, errors, actual, {RAW: uncalibrated(errors), **c.methods}, c.channels)
        for c in calibrations(errors, identified, transferred, hybrids)[:2]
    ]
    begins()
    trial = sea_trial(platforms[0], motion, sea.rate_hz, settings)
    poses = configurations(platforms[1], readings, identified.held_out.test)
    sources = {name: session.entries[name].digest for name in ("measure", "identify", "transfer", "correct")}
    provenance = {"version": version("kincal"), "command": command, "inputs": sources}
    return Found(trial, poses, document(trial, poses, {"said": sentence, **_sea_of(sea, log)}, provenance))


def _seaway(sea: Seaway) -> tuple[ShipMotion, str]:
    motion = generated(sea.model_copy(update={"minutes": sea.minutes + START_S / 60}), rao_of(sea))
    ship = sea.rao.name if sea.rao else f"a ship of {sea.vessel.length_m:g} x {sea.vessel.beam_m:g} m"
    return motion, (
        f"Sea state {sea.sea_state} (JONSWAP, {sea.significant_height:g} m, {sea.peak_period:g} s), "
        f"heading {sea.heading_deg:g} degrees, {sea.speed_knots:g} knots, {ship}"
    )


def _replay(log: Path, sea: Seaway) -> tuple[ShipMotion, str]:
    """The log's own motion, from its beginning; as many minutes of it as there are, at most as many as asked for."""
    from kincal.identification.streams.reading import read_log
    from kincal.urdf.description import Measure

    samples, health = read_log(log, Measure())
    heave = samples["heave"].to_numpy(float) if "heave" in samples else None
    yaw = samples["yaw"].to_numpy(float) if "yaw" in samples else np.zeros(len(samples))
    t, roll, pitch = samples[["t", "roll", "pitch"]].to_numpy(float).T
    motion = replayed(t, roll, pitch, yaw, heave, sea.rate_hz, str(log))
    most = round((START_S + 60 * sea.minutes) * sea.rate_hz)
    columns = {name: values[:most] for name, values in vars(motion).items() if isinstance(values, np.ndarray)}
    return replace(motion, **columns), f"The motion recorded in {log.name}, {health.samples} samples"


def _sea_of(sea: Seaway, log: Path | None) -> dict[str, Any]:
    return {"log": str(log)} if log else {"seaway": sea.model_dump(mode="json")}


def write(results: Found, folder: Path) -> Path:
    """index.html, results.json, series.parquet and the figures; the page last. Returns the page. Raises InputError."""
    from markupsafe import Markup

    from kincal.pipeline.report.figures import inline
    from kincal.pipeline.sea.trial_figures import figures

    drawn = figures(results.trial, results.poses)
    page = environment(Path(__file__).parent / "templates")
    page.filters["significant"] = significant
    html = page.get_template("voyage.html").render(
        document=results.document,
        axes=AXES,
        start=START_S,
        figures={name: Markup(inline(svg, name)) for name, svg in drawn.items()},
    )
    files = {
        **{f"{name}.svg": svg.encode() for name, svg in drawn.items()},
        "series.parquet": series(results.trial).to_parquet(index=False),
        "results.json": (json.dumps(results.document, indent=1, allow_nan=False) + "\n").encode(),
        "index.html": html.encode(),
    }
    replace_files(folder, files, str(folder))
    return folder / "index.html"
