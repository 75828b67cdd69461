"""A URDF or an MJCF -> a proposal for its robot.toml: loops, frames, actuators, a workspace that stands the checks."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import combinations, islice
from pathlib import Path

import numpy as np

from kincal.urdf.assembly import assembled, home_pose
from kincal.urdf.closed_chain import BASE, ClosedChain, load_chain, load_drawing
from kincal.urdf.description import Mechanism, Workspace
from kincal.urdf.drawing import Drawing
from kincal.urdf.errors import InputError
from kincal.urdf.input_files import read_text
from kincal.urdf.kinematics import at_home, loop_jacobian, tool_jacobian, tool_pose, tree
from kincal.urdf.proposed_loops import (
    TOLERANCES,
    Link,
    Meeting,
    coinciding,
    links_of,
    nearest_pairs,
    paired,
    random_configurations,
    size_of,
    with_loops,
)
from kincal.urdf.rigid_motion import Motion, log, xyz_angles
from kincal.urdf.workspace import AXES, condition_numbers, mobility

_ROTATION_DEG = 10.0  # of the first workspace that is tried
_SHRUNK = (1.0, 0.5, 0.25, 0.1)
_ALIGNED = 1e-6  # [rad]
_ATTEMPTS = 4  # at closing the loops of what is but an idea
_TOOL_NAMES = r"(?i)(^|[_/-])(tool\d*|tcp|ee|end_?effector|flange)([_/-]|$)"


@dataclass(frozen=True)
class Proposal:
    """What robot.toml may say of a drawing, and why."""

    name: str  # of the robot, as its file has it
    mechanism: Mechanism
    mobility: int
    how: str  # the loops were found: file, coinciding, nearly, paired; or none
    n_loops: int  # of the mechanism, those of an MJCF included
    meetings: tuple[Meeting, ...]  # the loops in [[loop]]
    candidates: tuple[Meeting, ...]  # pairs of frames that may meet as well
    spare_frames: tuple[str, ...]  # that may be the tool frame as well
    spare_joints: tuple[str, ...]  # that may be driven as well
    size: float  # of the robot [m]
    not_as_drawn: str | None  # why home is another pose than the one that the file shows
    problem: str | None  # why the stage `model` refuses it


@dataclass(frozen=True)
class _Closing:
    """The drawing with its loops, closed if they can be; no tool axes yet."""

    chain: ClosedChain
    how: str
    kind: str = "point"
    meetings: tuple[Meeting, ...] = ()
    candidates: tuple[Meeting, ...] = ()
    problem: str | None = None


def propose(file: Path) -> Proposal:
    """A proposal for a URDF or an MJCF. Raises InputError where that can't be read, or nothing in it moves."""
    text = read_text(file)
    drawing = load_drawing(text, file)
    names = tuple(drawing.model.names[1:])
    if not names:
        raise InputError(f"{file}: no joint moves; there is nothing to calibrate")
    nowhere = Workspace(rotation_deg={"x": (-_ROTATION_DEG, _ROTATION_DEG)})
    root = Mechanism(base_frame=drawing.root, tool_frame=drawing.root, actuated=names[:1], workspace=nowhere)
    bare = replace(load_chain(root, text, file), tool_axes=())
    links = links_of(drawing)
    closing = _closing(drawing, bare, links)
    tool = _tool(closing.chain, links)
    chain = replace(closing.chain, tool_joint=tool.joint, tool=tool.placement)
    free = mobility(chain)
    actuated = _actuated(chain, drawing, free)
    axes, problem = _axes(chain, free)
    mechanism = Mechanism(
        base_frame=drawing.root,
        tool_frame=tool.name,
        actuated=tuple(names[j] for j in actuated),
        workspace=nowhere,
        loop=tuple(meeting.loop(closing.kind) for meeting in closing.meetings),
    )
    size = size_of(bare, links)
    attempt = _Attempt(mechanism, text, file, axes, size)
    refusal = closing.problem or problem
    if refusal is None:
        mechanism, refusal = _with_workspace(attempt, chain)
    moved = home_pose(mechanism.workspace) is not None
    taken = {frame for loop in chain.loops for frame in loop.frames} | {tool.name}
    return Proposal(
        name=drawing.model.name,
        mechanism=mechanism,
        mobility=free,
        how=closing.how,
        n_loops=len(chain.loops),
        meetings=closing.meetings,
        candidates=closing.candidates,
        spare_frames=tuple(link.name for link in links if link.joint == tool.joint and link.name not in taken),
        spare_joints=tuple(name for j, name in enumerate(names) if j not in actuated),
        size=size,
        not_as_drawn=attempt.refusals[0] if moved and attempt.refusals else None,
        problem=refusal,
    )


# Loops


def _closing(drawing: Drawing, bare: ClosedChain, links: Sequence[Link]) -> _Closing:
    """The first of several ideas that makes a mechanism; else what coincides, be it as it may."""
    if drawing.loops:
        return _close(bare, _Closing(bare, "file"))
    size = size_of(bare, links)
    seen: _Closing | None = None
    for tolerance, how in zip(TOLERANCES, ("coinciding", "nearly"), strict=True):
        meetings, q = coinciding(bare, links, tolerance * size)
        if meetings and not (seen and len(meetings) <= len(seen.meetings)):
            kept, repeated = _without_repeats(replace(bare, home=q), meetings)
            aligned = all(meeting.turned < max(_ALIGNED, tolerance) for meeting in kept)
            idea = _Closing(bare, how, meetings=tuple(kept), candidates=tuple(repeated))
            closing = _mechanism(bare, idea, ("point", "frame") if aligned else ("point",), links)
            if closing:
                return closing
            seen = seen or _close(bare, idea)
    guesses = list(islice(paired(bare, links), 2))
    for guess in guesses:
        pairs = [{end.name for end in meeting.ends} for meeting in guess]
        if seen is None or all({end.name for end in meeting.ends} in pairs for meeting in seen.meetings):
            closing = _mechanism(bare, _Closing(bare, "paired", meetings=tuple(guess)), ("point", "frame"), links)
            if closing:
                return closing
    candidates = guesses[0] if guesses else nearest_pairs(bare, links, 5)
    return seen or _Closing(bare, "none", candidates=tuple(candidates))


def _without_repeats(bare: ClosedChain, meetings: Sequence[Meeting]) -> tuple[list[Meeting], list[Meeting]]:
    """Two bodies that meet twice meet as a hinge: loops that add dependent equations only are left out."""
    kept: list[Meeting] = []
    repeated: list[Meeting] = []
    for meeting in meetings:
        joints = {end.joint for end in meeting.ends}
        again = any({end.joint for end in other.ends} == joints for other in kept)
        (repeated if again and _dependent(with_loops(bare, [*kept, meeting], "point")) else kept).append(meeting)
    return kept, repeated


def _dependent(chain: ClosedChain) -> bool:
    return chain.n_joints - mobility(chain) < chain.n_equations


def _mechanism(bare: ClosedChain, idea: _Closing, kinds: Sequence[str], links: Sequence[Link]) -> _Closing | None:
    """With loops of the first kind that makes a mechanism which kincal can calibrate."""
    for kind in kinds:
        chain = with_loops(bare, idea.meetings, kind)
        if 0 < chain.n_joints - chain.n_equations <= len(AXES):  # no other number can come of independent loops
            closing = _close(bare, replace(idea, kind=kind))
            if _fit(closing, links):
                return closing
    return None


def _close(bare: ClosedChain, closing: _Closing) -> _Closing:
    chain = with_loops(bare, closing.meetings, closing.kind)
    try:
        return replace(closing, chain=at_home(chain, None, attempts=_ATTEMPTS))
    except InputError as error:
        problem = str(error).replace("with the tool at home ", "", 1)
    with suppress(InputError):  # closed somewhere, and from there into the limits
        home = _centred(replace(chain, home=at_home(_unlimited(chain), None, attempts=_ATTEMPTS).home))
        if np.all((home >= chain.lower) & (home <= chain.upper)):
            return replace(closing, chain=replace(chain, home=home))
    return replace(closing, chain=chain, problem=problem)


def _fit(closing: _Closing, links: Sequence[Link]) -> bool:
    """Whether the loops close, independently, and the tool shows every motion that they leave."""
    if closing.problem is not None or _dependent(closing.chain):
        return False
    tool = _tool(closing.chain, links)
    return _axes(replace(closing.chain, tool_joint=tool.joint, tool=tool.placement), mobility(closing.chain))[1] is None


# Frames, actuators, axes


def _tool(chain: ClosedChain, links: Sequence[Link]) -> Link:
    """On the body where most loops and branches meet; of a serial arm the last frame."""
    moving = [link for link in links if link.joint != BASE] or list(links)
    depth = {link.joint: len(chain.path(link.joint)) for link in moving}
    if chain.loops:
        meeting = Counter([*(j for loop in chain.loops for j in loop.joints), *chain.parents])
        joint = max(depth, key=lambda j: (meeting[j], depth[j]))
        return max((link for link in moving if link.joint == joint), key=lambda link: link.children)
    joint = max(depth, key=lambda j: depth[j])
    on_joint = [link for link in moving if link.joint == joint]
    called = [link for link in on_joint if re.search(_TOOL_NAMES, link.name)]
    return (called or on_joint)[-1]


def _motions(chain: ClosedChain) -> np.ndarray:
    """(n_joints, mobility): orthonormal joint rates that keep the loops closed, slides in lengths of the robot."""
    if not chain.n_equations:
        return np.eye(chain.n_joints)
    unit = np.where(chain.prismatic, _length(chain), 1.0)
    right = np.linalg.svd(loop_jacobian(chain, tree(chain, chain.home[None]))[0] * unit)[2]
    return right[chain.n_joints - mobility(chain) :].T


def _length(chain: ClosedChain) -> float:
    return float(np.max(np.linalg.norm(chain.translation, axis=1))) or 1.0


def _actuated(chain: ClosedChain, drawing: Drawing, free: int) -> list[int]:
    """As many joints as there are degrees of freedom, which the others follow from: driven ones of an MJCF, slides,
    joints at the base, others from the base on."""
    names = list(drawing.model.names[1:])
    driven = {names.index(name) for name in drawing.driven}
    serial = not chain.n_equations
    order = sorted(
        range(chain.n_joints),
        key=lambda j: (
            j not in driven,
            not serial and not chain.prismatic[j],
            not serial and chain.parents[j] != BASE,
            len(chain.path(j)),
        ),
    )
    motions, chosen = _motions(_beside(chain)), []
    basis = np.zeros((0, motions.shape[1]))
    for j in order:
        rest = motions[j] - basis.T @ (basis @ motions[j])
        if len(chosen) < free and np.linalg.norm(rest) > 1e-3:
            chosen.append(j)
            basis = np.concatenate([basis, rest[None] / np.linalg.norm(rest)])
    return sorted(chosen) or order[:1]


def _axes(chain: ClosedChain, free: int) -> tuple[tuple[int, ...], str | None]:
    """The tool coordinates that tell the mechanism's motions apart best; or why none do."""
    if not 0 < free <= len(AXES):
        more = "name loops that are missing, or make joints fixed that stand still" if free else "drop loops"
        return (), f"the mechanism has {free} degrees of freedom, a tool at most 6: {more}"
    chain = _beside(chain)
    chain = replace(chain, home_pose=tool_pose(chain, tree(chain, chain.home[None]))[0])
    motions = _motions(chain) * np.where(chain.prismatic, _length(chain), 1.0)[:, None]
    rates = tool_jacobian(chain, tree(chain, chain.home[None]))[0] @ motions
    sizes = [np.linalg.norm(part) for part in (rates[:3], rates[3:])]
    if min(sizes) > 1e-9 * max(sizes):
        rates[:3] *= sizes[1] / sizes[0]
    rank = np.linalg.matrix_rank(rates, tol=1e-6 * max(np.linalg.norm(rates), 1e-300))
    if rank < free:
        return (), (
            f"the mechanism has {free} degrees of freedom, but the tool shows {rank} of them: a part turns on itself "
            "or moves alone (make that joint fixed), a loop is missing, or it should be one of frames"
        )
    rates /= max(np.linalg.norm(rates), 1e-300)
    best = max(combinations(range(6), free), key=lambda axes: round(float(np.linalg.svd(rates[list(axes)])[1][-1]), 6))
    return best, None


# The workspace


@dataclass
class _Attempt:
    """Workspaces of a mechanism, tried until one stands the checks."""

    mechanism: Mechanism
    text: str
    file: Path
    axes: tuple[int, ...]
    size: float
    refusals: list[str] = field(default_factory=list)

    def with_workspace(self, home: dict, shrunk: float) -> Mechanism:
        length = _round_down(50 * self.size)
        ranges: dict[str, dict] = {"translation_mm": {}, "rotation_deg": {}}
        for axis in self.axes:
            kind, bound = ("translation_mm", length) if axis < 3 else ("rotation_deg", _ROTATION_DEG)
            ranges[kind][AXES[axis][-1]] = (-shrunk * bound, shrunk * bound)
        return self.mechanism.model_copy(update={"workspace": Workspace.model_validate({**ranges, **home})})

    def stands(self, mechanism: Mechanism) -> bool:
        try:
            assembled(mechanism, self.text, self.file)
        except InputError as error:
            self.refusals.append(str(error))
            return False
        return True


def _with_workspace(attempt: _Attempt, closed: ClosedChain) -> tuple[Mechanism, str | None]:
    """The mechanism with a home and ranges that stand the checks; else with the first ones, and why they don't."""
    first = None
    for home in _homes(attempt, closed):
        for shrunk in _SHRUNK:
            mechanism = attempt.with_workspace(home, shrunk)
            if attempt.stands(mechanism):
                return mechanism, None
            first = first or mechanism
            if not attempt.refusals[-1].startswith("workspace: pose"):
                break  # no smaller one will do either
    return first or attempt.with_workspace({}, 1.0), attempt.refusals[0]


def _homes(attempt: _Attempt, closed: ClosedChain) -> Iterator[dict]:
    """Home poses for [workspace]: as drawn if that is any good, then others: the nearest, the best conditioned."""
    workspace = attempt.with_workspace({}, 1.0).workspace
    chain = load_chain(attempt.mechanism.model_copy(update={"workspace": workspace}), attempt.text, attempt.file)
    try:
        at_home(chain, None, attempts=_ATTEMPTS)
        yield {}
    except InputError as error:
        attempt.refusals.append(str(error))
    drawn = tool_pose(chain, tree(chain, chain.drawn[None])).rotation[0]
    for q in _configurations(chain, closed):
        pose = tool_pose(chain, tree(chain, q[None]))[0]
        if np.linalg.norm(log(drawn.T @ pose.rotation)) < np.deg2rad(30):
            yield _written(Motion(drawn, pose.translation), attempt.size)
        yield _written(pose, attempt.size)


def _configurations(chain: ClosedChain, closed: ClosedChain) -> Iterator[np.ndarray]:
    """Closed configurations (n_joints,) that may be a home: amid the joint limits, then random ones, the best first."""
    if chain.n_equations:
        yield _centred(closed)
    yield closed.home
    starts = random_configurations(chain, 5 if chain.n_equations else 300, 1)
    middle = np.mean(starts, axis=0)
    configurations = []
    for start in middle + 0.6 * (starts - middle):
        with suppress(InputError):
            configurations.append(_near(closed, start).home if chain.n_equations else start)
    yield from sorted(configurations, key=lambda q: _condition(chain, q))[:4]


def _centred(closed: ClosedChain) -> np.ndarray:
    """The joints moved towards the middle of their limits, the loops kept closed (Gauss-Newton in the free motions)."""
    bounded = np.isfinite(closed.lower) & np.isfinite(closed.upper) & (closed.lower < closed.upper)
    width = np.where(bounded, closed.upper - closed.lower, np.inf)
    middle = 0.5 * (np.where(bounded, closed.lower, 0) + np.where(bounded, closed.upper, 0))
    unit = np.where(closed.prismatic, _length(closed), 1.0)[:, None]
    closed = _unlimited(closed)
    for _ in range(10):
        motions = _motions(closed) * unit
        step = np.linalg.lstsq(motions / width[:, None], (middle - closed.home) / width, rcond=None)[0]
        try:
            closed = _near(closed, closed.home + motions @ step)
        except InputError:
            break
    return closed.home


def _unlimited(chain: ClosedChain) -> ClosedChain:
    return replace(chain, lower=np.full(chain.n_joints, -np.inf), upper=np.full(chain.n_joints, np.inf))


def _beside(closed: ClosedChain) -> ClosedChain:
    """In a closed configuration a little aside: a drawing is often symmetric, and may be singular."""
    aside = closed.home + 0.05 * np.random.default_rng(2).normal(size=closed.n_joints)
    if not closed.n_equations:
        return replace(closed, home=aside)
    with suppress(InputError):
        return _near(closed, np.clip(aside, closed.lower, closed.upper))
    return closed


def _near(closed: ClosedChain, q: np.ndarray) -> ClosedChain:
    """At home in the closed configuration next to q: (n_joints,)."""
    return at_home(replace(closed, home=q), None, attempts=_ATTEMPTS)


def _condition(chain: ClosedChain, q: np.ndarray) -> float:
    moved_chain = replace(chain, home=q, home_pose=tool_pose(chain, tree(chain, q[None]))[0])
    try:
        return float(condition_numbers(moved_chain, q[None])[0])
    except np.linalg.LinAlgError:
        return np.inf


def _written(pose: Motion, size: float) -> dict:
    """A home pose in round numbers."""
    step = 10 if size > 0.3 else 1
    angles = np.rad2deg(xyz_angles(pose.rotation))
    return {
        "home_mm": tuple(float(v) + 0.0 for v in step * np.round(1e3 * pose.translation / step)),
        "home_rotation_deg": tuple(float(v) + 0.0 for v in 5 * np.round(angles / 5)),
    }


def _round_down(value: float) -> float:
    """To one of 1, 2, 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(step for step in (1, 2, 5) if step * power <= value * (1 + 1e-9)) * power)
