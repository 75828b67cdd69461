"""A sea trial for programs and people: the document, its tables, and the time series."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from kincal.pipeline.report.numbers import significant
from kincal.pipeline.report.paper import AXES, HARDWARE
from kincal.pipeline.report.tables import Table
from kincal.pipeline.sea.configurations import Configurations
from kincal.pipeline.sea.trial import SeaTrial

if TYPE_CHECKING:
    import pandas as pd

_PLACES = {"mean": "mean_deg", "max": "max_deg", "sd": "sd_deg"}


def document(
    trial: SeaTrial, poses: Configurations, motion: Mapping[str, Any], provenance: Mapping[str, Any]
) -> dict[str, Any]:
    """All figures of a trial, in plain values [deg]."""
    ship = np.rad2deg(trial.ship)
    filtered = np.rad2deg(trial.filtered) - ship[:, :2]
    bias = filtered.mean(axis=0)
    return {
        "schema": "kincal-sea-trial-1",
        "robot": trial.robot,
        **provenance,
        "motion": {
            **motion,
            "seconds": len(trial.t) / trial.rate_hz,
            "rate_hz": trial.rate_hz,
            "rms_deg": dict(zip(("roll", "pitch", "yaw"), ship.std(axis=0).tolist(), strict=True)),
            "max_deg": dict(zip(("roll", "pitch", "yaw"), np.abs(ship).max(axis=0).tolist(), strict=True)),
        },
        "settings": trial.settings.model_dump(mode="json"),
        "scored": "orientation" if trial.full else "tilt",
        "deck_error": [
            {"method": s.name, **indices(s.error, trial.full), "not_reached": s.not_reached} for s in trial.methods
        ],
        "calibration": [{"method": s.name, **indices(s.calibration, trial.full)} for s in trial.methods],
        "budget": _budget(trial),
        "filter": {
            "rms_deg": dict(zip(("roll", "pitch"), np.sqrt(np.mean(filtered**2, axis=0)).tolist(), strict=True)),
            "bias_deg": dict(zip(("roll", "pitch"), bias.tolist(), strict=True)),
            "rms_net_of_bias_deg": dict(zip(("roll", "pitch"), filtered.std(axis=0).tolist(), strict=True)),
            "innovations": [
                {
                    "channel": i.channel,
                    "updates": i.updates,
                    "gated": i.gated,
                    "mean": i.mean,
                    "band": list(i.band),
                    "inside": i.inside,
                    "warning": i.warning,
                }
                for i in trial.innovations
            ],
        },
        "deck_sensor": [
            {
                "method": w.name,
                "says": indices(_tilt(w.angles), False),
                "is": indices(_tilt(w.actual), False),
                "bias_deg": dict(
                    zip(("roll", "pitch"), np.rad2deg((w.angles - w.actual).mean(axis=0)).tolist(), strict=True)
                ),
            }
            for w in trial.watched
        ],
        "configurations": {
            "training": len(poses.desired) - len(poses.test),
            "testing": len(poses.test),
            "rows": [
                {
                    "method": name,
                    **indices(error[poses.test], trial.full),
                    "tilted": indices(poses.tilted[name][poses.test], trial.full),
                    "paper": HARDWARE.get(name),
                }
                for name, error in poses.errors.items()
            ],
        },
    }


def indices(error: np.ndarray, full: bool) -> dict[str, Any]:
    """Eq. 7-10 of the paper: of errors (n, 3) [rad], per axis and volumetric, [deg]; rows of NaN don't count."""
    known = np.rad2deg(error[np.isfinite(error).all(axis=1)])
    if not len(known):
        return {key: dict.fromkeys(AXES) for key in _PLACES.values()}
    columns = np.column_stack([np.abs(known), np.linalg.norm(known, axis=1)])
    by_axis = {}
    for how, key in _PLACES.items():
        values = {"mean": columns.mean, "max": columns.max, "sd": columns.std}[how](axis=0)
        by_axis[key] = dict(zip(AXES, values.tolist(), strict=True))
        if not full:
            by_axis[key]["z"] = None
    return by_axis


def _tilt(angles: np.ndarray) -> np.ndarray:
    return np.column_stack([angles, np.zeros(len(angles))])


def _budget(trial: SeaTrial) -> list[dict[str, Any]]:
    """What the deck's error is made of, by the last of the methods: each part alone, and all together."""
    last = trial.methods[-1]
    filtered = trial.parts["filter"]
    mean = filtered.mean(axis=0)
    rows = {
        f"calibration ({last.name})": last.calibration,
        "load of a moving ship": trial.parts["load of a moving ship"],
        "filter": filtered,
        "filter: its mean, the accelerometers' bias": np.broadcast_to(mean, filtered.shape),
        "filter: about its mean": filtered - mean,
        "delay, not looked ahead": trial.parts["delay"],
        "actuators, not looked ahead": trial.parts["actuators"],
        "delay and actuators, looked ahead": trial.parts["delay and actuators, looked ahead"],
        "all together": last.error,
    }
    if not trial.settings.lead:
        del rows["delay and actuators, looked ahead"]
    budget = []
    for name, error in rows.items():
        size = np.rad2deg(np.linalg.norm(error, axis=1))
        size = size[np.isfinite(size)]
        budget.append(
            {
                "part": name,
                "mean_deg": float(size.mean()),
                "rms_deg": float(np.sqrt(np.mean(size**2))),
                "max_deg": float(size.max()),
            }
        )
    return budget


def series(trial: SeaTrial) -> pd.DataFrame:
    """The trial's time series: t [s], all else in degrees (single precision)."""
    import pandas as pd

    columns: dict[str, np.ndarray] = {"t": trial.t}
    for k, name in enumerate(("roll", "pitch", "yaw")):
        columns[f"ship_{name}_deg"] = trial.ship[:, k]
    for k, name in enumerate(("roll", "pitch")):
        columns[f"filtered_{name}_deg"] = trial.filtered[:, k]
    for sailed in trial.methods:
        for k, axis in enumerate("xyz" if trial.full else "xy"):
            columns[f"{_word(sailed.name)}_{axis}_deg"] = sailed.error[:, k]
    for watched in trial.watched:
        for k, name in enumerate(("roll", "pitch")):
            columns[f"deck_sensor_{_word(watched.name)}_{name}_deg"] = watched.angles[:, k]
    table = pd.DataFrame(columns)
    table.iloc[:, 1:] = np.rad2deg(table.iloc[:, 1:].to_numpy())
    return table.astype({name: "float32" for name in columns if name != "t"})


def _word(name: str) -> str:
    return name.replace(", ", "_").replace(" ", "_")


def summary(document: dict[str, Any]) -> list[tuple[str, Table]]:
    """For the terminal: the deck by method, what it is made of, and the paper's table 4 beside ours."""
    calibration = {row["method"]: row for row in document["calibration"]}
    decks = [
        (
            row["method"],
            *(significant(row[key]["volumetric"]) for key in ("mean_deg", "max_deg", "sd_deg")),
            *(significant(row["mean_deg"][axis]) for axis in AXES[:3]),
            significant(calibration[row["method"]]["mean_deg"]["volumetric"]),
            str(row["not_reached"] or ""),
        )
        for row in document["deck_error"]
    ]
    parts = [
        (row["part"], *(significant(row[key]) for key in ("mean_deg", "rms_deg", "max_deg")))
        for row in document["budget"]
    ]
    rows = []
    for row in document["configurations"]["rows"]:
        cells: list[str] = [row["method"]]
        for how, key in _PLACES.items():
            printed = row["paper"]
            cells += [significant(row[key]["volumetric"]), f"{printed[how][3]:.3f}" if printed else ""]
        rows.append((*cells, significant(row["tilted"]["mean_deg"]["volumetric"])))
    share = "of it calibration" if document["scored"] == "orientation" else "of it calibration (tilt)"
    columns = ("method", "mean", "max", "SD", "x", "y", "z", share, "out of reach")
    n = document["configurations"]["testing"]
    return [
        (f"deck error [deg] over {document['motion']['seconds']:g} s at sea", Table(columns, tuple(decks))),
        ("what it is made of, each part alone [deg]", Table(("part", "mean", "rms", "max"), tuple(parts))),
        (
            f"table 4: {n} testing configurations, compensated one by one [deg]",
            Table(("method", "mean", "paper", "max", "paper", "SD", "paper", "mean, tilted load"), tuple(rows)),
        ),
    ]
