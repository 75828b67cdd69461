"""Rank and unobservable directions, against numpy on fresh poses and against the residuals themselves."""

from __future__ import annotations

import re

import numpy as np
import pytest

from kincal.identification.estimators import estimate_parameters
from kincal.identification.identifiability import identifiability

CASES = [
    ("ur10", ("orientation", "position")),
    ("ups3_s", ("orientation",)),
    ("ups3_s", ("tilt",)),
    ("ups3_frame", ("orientation",)),
    ("jugglebot", ("orientation", "position")),
]


def enough_poses(loaded, channels) -> int:
    """Twice as many rows as parameters."""
    rows = sum({"orientation": 3, "position": 3, "tilt": 2, "yaw": 1}[c] for c in channels)
    return 2 * len(loaded.model.parameters) // rows + 1


def frames_alone(loaded) -> np.ndarray:
    """p of a robot as drawn, its W and T off."""
    p = loaded.random_parameters(1)
    p[:-12] = 0
    return p


def linearised(loaded, channels, n: int, seed: int, p=None) -> np.ndarray:
    """The Jacobian (sigma 1) at p, by default of a robot as drawn with W and T off."""
    p = frames_alone(loaded) if p is None else p
    measured = loaded.measure(p, loaded.readings(n, seed), channels, dict.fromkeys(channels, 1.0))
    return loaded.model.jacobian(p, measured).reshape(-1, len(p))


def scaled(loaded) -> np.ndarray:
    """Parameters in units of their tolerance; 1 mm and 1 mrad for W and T."""
    parameters = loaded.model.parameters
    return np.where(parameters.flat, 1e-3, parameters.tolerance)


@pytest.mark.parametrize("name, channels", CASES)
def test_rank_is_that_of_fresh_poses(name, channels, robot):
    """numpy.linalg.matrix_rank of the Jacobian at poses of another seed; the gap is ten orders (science.md, trap 9)."""
    loaded = robot(name)
    n = enough_poses(loaded, channels)
    found = identifiability(linearised(loaded, channels, n, 1), loaded.model.parameters)
    fresh = linearised(loaded, channels, n, 2)
    assert found.rank == np.linalg.matrix_rank(fresh * scaled(loaded), rtol=1e-9)
    assert len(found.unobservable) == len(loaded.model.parameters) - found.rank
    assert found.singular_values[found.rank] < 1e-9 * found.singular_values[found.rank - 1]
    assert found.condition_number == pytest.approx(found.singular_values[0] / found.singular_values[found.rank - 1])


@pytest.mark.parametrize("name, channels", CASES)
def test_rank_at_an_identified_robot_is_that_of_fresh_poses(name, channels, robot):
    """Where identification ended, off from the drawing: the singular values spread, the null ones stay at rounding."""
    loaded = robot(name)
    n = enough_poses(loaded, channels)
    truth, noise = loaded.random_parameters(2), np.random.default_rng(2)
    measured = loaded.measure(truth, loaded.readings(n, 1), channels, dict.fromkeys(channels, 1e-5), noise)
    estimate = estimate_parameters(loaded.model, measured)
    found = identifiability(estimate.triangle[:, :-1], loaded.model.parameters, measured.rows)
    fresh = linearised(loaded, channels, n, 2, estimate.p)
    assert found.rank == np.linalg.matrix_rank(fresh * scaled(loaded), rtol=1e-13)


@pytest.mark.parametrize("name, channels", CASES)
def test_adding_poses_does_not_change_the_rank(name, channels, robot):
    loaded = robot(name)
    n = enough_poses(loaded, channels)
    ranks = {identifiability(linearised(loaded, channels, k * n, 3), loaded.model.parameters).rank for k in (1, 2, 3)}
    assert len(ranks) == 1


@pytest.mark.parametrize("channels", [("orientation",), ("tilt",)], ids="+".join)
def test_a_parameter_that_moves_nothing_is_never_identifiable(channels, robot):
    """A robot that is off in every parameter: columns of zeros (translations of W and T) stay outside the rank."""
    loaded = robot("ups3_s")
    jacobian = linearised(loaded, channels, 150, 1, loaded.random_parameters(1))
    still = ~jacobian.any(axis=0)
    assert still.sum() >= 6
    found = identifiability(jacobian, loaded.model.parameters)
    assert found.rank <= len(still) - still.sum()
    assert not found.identifiable[still].any()


def test_ur10_has_the_textbooks_rank(robot):
    """Everett, Driels, Mooring 1987: 4 a revolute joint (its zero among them), 6 for the frames; here 6 gains more."""
    loaded = robot("ur10")
    jacobian = linearised(loaded, ("orientation", "position"), 60, 4)
    assert identifiability(jacobian, loaded.model.parameters).rank == 4 * 6 + 6 + 6


_UNITS = {"mm": 1e-3, "deg": np.pi / 180, "mm/reading": 1e-3, "deg/reading": np.pi / 180}
_SHORT = re.compile(r"(\S+) trades against (\S+) 1:(-?1)")
_LONG = re.compile(r"(\S+) trades against (.+?)(?: \(and (\d+) by less\))?, (1 \S+(?: : \S+ \S+)+)")


def read_back(text: str, parameters) -> tuple[str, dict[str, float], int]:
    """A written direction: who leads it, what it holds in SI units, and how many smaller ones it leaves out."""
    if match := re.fullmatch(r"(\S+) has no effect on the measurements", text):
        return match[1], {match[1]: 1.0}, 0
    if match := _SHORT.fullmatch(text):
        return match[1], {match[1]: 1.0, match[2]: float(match[3])}, 0
    lead, others, smaller, ratio = _LONG.fullmatch(text).groups()
    names, terms = [lead, *re.split(", | and ", others)], [term.split() for term in ratio.split(" : ")]
    for name, (_, unit) in zip(names, terms, strict=True):
        assert unit.endswith("/reading") == name.endswith(".gain")
        assert unit.startswith("mm") == parameters.units[parameters.names.index(name)].startswith("m")
    held = {name: float(size) * _UNITS[unit] for name, (size, unit) in zip(names, terms, strict=True)}
    return lead, held, int(smaller or 0)


@pytest.mark.parametrize("name, channels", CASES)
def test_basis_of_what_is_not_seen(name, channels, robot):
    """Orthonormal, in the Jacobian's null space (relative to the tolerance), and all of it: rank is what it leaves."""
    loaded = robot(name)
    jacobian = linearised(loaded, channels, enough_poses(loaded, channels), 5)
    found = identifiability(jacobian, loaded.model.parameters)
    n = len(loaded.model.parameters)
    assert found.basis.shape == (n - found.rank, n)
    np.testing.assert_allclose(found.basis @ found.basis.T, np.eye(n - found.rank), rtol=0, atol=1e-12)
    assert np.linalg.norm(jacobian * scaled(loaded) @ found.basis.T, 2) < found.tolerance
    smallest = np.linalg.svd(jacobian * scaled(loaded), compute_uv=False)[found.rank - 1]
    assert smallest > found.tolerance
    assert smallest == pytest.approx(found.singular_values[found.rank - 1])
    assert found.gap == pytest.approx(found.singular_values[found.rank - 1] / found.singular_values[found.rank])
    assert found.gap > 1e8  # science.md, trap 9


@pytest.mark.parametrize("name, channels", CASES)
def test_written_directions_are_in_the_null_space(name, channels, robot):
    """Read back from the text, in SI units: they move no residual, but for the three digits they are written in.

    A direction with smaller terms left out is completed by the basis: the one vector there that holds 1 of its lead
    and nothing of the others' leads.
    """
    loaded = robot(name)
    jacobian = linearised(loaded, channels, enough_poses(loaded, channels), 5)
    parameters, scale = loaded.model.parameters, scaled(loaded)
    found = identifiability(jacobian, parameters)
    read = [read_back(text, parameters) for text in found.unobservable]
    leads = [parameters.names.index(lead) for lead, _, _ in read]
    assert len(set(leads)) == len(read) == len(parameters) - found.rank > 0
    written = 0
    for k, (_, held, smaller) in enumerate(read):
        direction = np.zeros(len(parameters))
        for other, size in held.items():
            direction[parameters.names.index(other)] = size
        whole = np.linalg.solve(found.basis[:, leads].T, np.eye(len(leads))[k]) @ found.basis * scale
        whole *= direction[leads[k]] / scale[leads[k]]
        assert np.linalg.norm(jacobian @ whole) <= 1e-7 * np.linalg.norm(jacobian * whole) + 1e-12
        shown = direction != 0
        np.testing.assert_allclose(direction[shown], whole[shown], rtol=5e-3)
        left_out = ~shown & (np.abs(whole / scale) > 1e-6 * np.abs(whole / scale)[leads[k]])
        assert left_out.sum() == smaller
        assert np.all(np.abs(whole / scale)[left_out] <= np.min(np.abs(whole / scale)[shown]) + 1e-12)
        if not smaller:
            written += 1
            assert np.linalg.norm(jacobian @ direction) <= 5e-3 * np.linalg.norm(jacobian * direction) + 1e-9
    assert written >= len(read) // 3


@pytest.mark.parametrize("name, channels", [("ups3_s", ("orientation",)), ("ur10", ("orientation", "position"))])
def test_predictions_stay_along_what_is_not_seen(name, channels, robot):
    """Robots 10 tolerances off in random directions of the basis, loops closed anew: what moves is of second order."""
    loaded = robot(name)
    scale, at, readings = scaled(loaded), frames_alone(loaded), loaded.readings(8, 6)
    found = identifiability(linearised(loaded, channels, enough_poses(loaded, channels), 5), loaded.model.parameters)
    measured = loaded.measure(at, readings, channels, dict.fromkeys(channels, 1.0))

    def moved(direction: np.ndarray, size: float) -> float:
        robot = loaded.model.robot(at + size * scale * direction / np.linalg.norm(direction))
        return float(np.linalg.norm(loaded.model.residual(robot, robot.close(readings).q, measured)))

    random = np.random.default_rng(1)
    for _ in range(6):
        anywhere = moved(random.normal(size=len(scale)), 10)
        unseen = random.normal(size=len(found.basis)) @ found.basis
        whole, half = moved(unseen, 10), moved(unseen, 5)
        assert whole < 0.1 * anywhere
        assert half == pytest.approx(whole / 4, rel=0.05)


@pytest.mark.parametrize("name, channels", CASES)
def test_identifiable_parameters_do_not_take_part_in_the_null_space(name, channels, robot):
    """Share of each parameter's unit vector in numpy's row space, by a full SVD of the tall matrix."""
    loaded = robot(name)
    jacobian = linearised(loaded, channels, enough_poses(loaded, channels), 6)
    found = identifiability(jacobian, loaded.model.parameters)
    _, singular, vt = np.linalg.svd(jacobian * scaled(loaded), full_matrices=False)
    null_space = vt[singular < 1e-9 * singular[0]]
    np.testing.assert_allclose(found.observable_share, 1 - np.sum(null_space**2, axis=0), rtol=0, atol=1e-6)
    np.testing.assert_array_equal(found.identifiable, np.sum(null_space**2, axis=0) < 1e-6)


def test_what_orientation_alone_cannot_see_is_not_identifiable(robot):
    """A platform that turns about a fixed centre: instrument and target translations move no orientation."""
    loaded = robot("ups3_s")
    jacobian = linearised(loaded, ("orientation",), 80, 7)
    found = identifiability(jacobian, loaded.model.parameters)
    by_name = dict(zip(loaded.model.parameters.names, found.identifiable, strict=True))
    assert not any(by_name[f"{frame}.{c}"] for frame in ("instrument", "target") for c in "xyz")
    text = "\n".join(found.unobservable)
    assert "instrument.x has no effect on the measurements" in text
    assert "target.z has no effect on the measurements" in text


def test_tilt_loses_what_orientation_sees(robot):
    """science.md, trap 7: more is lost than yaw; the rank falls, never rises."""
    loaded = robot("ups3_s")
    ranks = [
        identifiability(linearised(loaded, channels, 150, 8), loaded.model.parameters).rank
        for channels in (("tilt",), ("tilt", "yaw"), ("orientation",), ("orientation", "position"))
    ]
    assert ranks[0] < ranks[1] == ranks[2] < ranks[3]
