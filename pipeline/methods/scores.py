"""The methods on the same poses, which none of them has seen. Everything is predicted in the measurement frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict

import numpy as np

from kincal.identification.accuracy import score
from kincal.identification.measurements import Measurements
from kincal.pipeline.methods.predictors import Method
from kincal.pipeline.results import MethodScore
from kincal.urdf.errors import InputError
from kincal.urdf.rigid_motion import Motion


def scores(
    methods: Mapping[str, Method], at: Measurements, actual: Motion, channels: tuple[str, ...]
) -> tuple[MethodScore, ...]:
    """One row a method, on poses (n) whose actual values are known."""
    return tuple(method_score(name, _predict(method, at), actual, channels) for name, method in methods.items())


def cross_validated(
    folds: Sequence[tuple[np.ndarray, Mapping[str, Method]]], measured: Measurements, channels: tuple[str, ...]
) -> tuple[MethodScore, ...]:
    """One row a method, every pose predicted by the fit that has not seen it. folds: (rows held out, its methods)."""
    actual = measured.as_poses()[np.concatenate([rows for rows, _ in folds])]
    found = []
    for name in folds[0][1]:
        parts = [_predict(methods[name], measured[rows]) for rows, methods in folds]
        predicted = Motion(np.concatenate([m.rotation for m in parts]), np.concatenate([m.translation for m in parts]))
        found.append(method_score(name, predicted, actual, channels))
    return tuple(found)


def _predict(method: Method, at: Measurements) -> Motion:
    try:
        return method.predict(at.readings)
    except InputError as error:
        raise InputError(f"pose {error}; check the joint values and their unit") from None


def method_score(name: str, predicted: Motion, actual: Motion, channels: tuple[str, ...]) -> MethodScore:
    return MethodScore(name=name, **asdict(score(actual, predicted, channels)))
