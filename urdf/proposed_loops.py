"""Which frames of a drawing meet? Those that coincide in it; where none do, those that names and distances pair."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import pinocchio as pin  # pyright: ignore[reportMissingImports] - a wheel without stubs

from kincal.urdf.closed_chain import BASE, ClosedChain, LoopClosure
from kincal.urdf.description import Loop
from kincal.urdf.drawing import Drawing
from kincal.urdf.kinematics import Tree, loop_jacobian, tree
from kincal.urdf.rigid_motion import Motion, log

TOLERANCES = (1e-6, 1e-3)  # of the robot's size: frames that coincide, and such as nearly do
_MAX_FRAMES = 2000
_LOCKED = 1e-6  # a joint that moves less, against the others, does not move
_SIDES = {"left", "right", "front", "rear", "back", "upper", "lower", "inner", "outer", "fl", "fr", "rl", "rr"}


@dataclass(frozen=True)
class Link:
    """A frame of the drawing: a link, or an MJCF's body or site."""

    name: str
    joint: int  # that carries it, BASE for none
    placement: Motion  # in that joint's frame
    children: int  # links, sites and joints that hang on it

    @property
    def leaf(self) -> bool:
        return self.children == 0


@dataclass(frozen=True)
class Meeting:
    """Two frames that may meet."""

    name: str  # of the loop
    ends: tuple[Link, Link]  # a leg's end first, then what it meets
    gap: float  # [m] as drawn
    turned: float  # [rad] between their orientations, as drawn

    def loop(self, kind: str) -> Loop:
        return Loop.model_validate({"name": self.name, "kind": kind, "frames": (self.ends[0].name, self.ends[1].name)})


def links_of(drawing: Drawing) -> list[Link]:
    """The frames that robot.toml can name, in the file's order."""
    kinds = (pin.FrameType.BODY, pin.FrameType.OP_FRAME)
    frames = list(drawing.model.frames)
    names = Counter(f.name for f in frames if f.type != pin.FrameType.JOINT)
    children = Counter(f.parentFrame for f in frames[1:])
    links = []
    for index, f in enumerate(frames):
        if f.type in kinds and names[f.name] == 1:
            placement = Motion(f.placement.rotation.copy(), f.placement.translation.copy())
            links.append(Link(f.name, f.parentJoint - 1, placement, children[index]))
    return links if len(links) <= _MAX_FRAMES else [link for link in links if not link.leaf][:_MAX_FRAMES]


def size_of(chain: ClosedChain, links: Sequence[Link]) -> float:
    """The robot's size as drawn [m]: the longest edge of the box around its frames."""
    at = _positions(links, tree(chain, chain.home[None]))[0]
    return float(np.max(at.max(axis=0) - at.min(axis=0))) or 1.0


def coinciding(chain: ClosedChain, links: Sequence[Link], tolerance: float) -> tuple[list[Meeting], np.ndarray]:
    """The pairs of frames that coincide within `tolerance` [m], and in which configuration: as drawn, or with the
    joints inside their limits.

    Frames that coincide in every configuration are held together by joints already; a pair whose loop would lock a
    joint coincides by chance (a slide of length zero).
    """
    for q in _drawn(chain):
        meetings = list(_coinciding(chain, links, tolerance, q))
        if meetings:
            return _named(meetings), q
    return [], chain.drawn


def _drawn(chain: ClosedChain) -> list[np.ndarray]:
    return [chain.drawn] if np.array_equal(chain.drawn, chain.home) else [chain.drawn, chain.home]


def _coinciding(chain: ClosedChain, links: Sequence[Link], tolerance: float, q: np.ndarray) -> Iterator[Meeting]:
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial.distance import cdist

    frames = tree(chain, np.stack([q, *random_configurations(chain, 3, 0)]))
    at = _positions(links, frames)
    near = cdist(at[0], at[0]) <= tolerance
    always = near & np.all([cdist(p, p) <= tolerance for p in at[1:]], axis=0)
    clusters, held = (connected_components(pairs, directed=False)[1] for pairs in (near, always))
    points = []
    for cluster in dict.fromkeys(clusters):
        members = [int(k) for k in np.flatnonzero(clusters == cluster)]
        groups = dict.fromkeys(int(held[k]) for k in members)
        ends = [_foremost(chain, [links[k] for k in members if held[k] == group]) for group in groups]
        if len(ends) > 1:
            points.append(ends)
    counts = Counter(end.joint for ends in points for end in ends if end.joint != BASE)
    offered = Counter(link.joint for link in links if link.leaf and link.joint != BASE)
    for ends in points:
        hub = max(ends, key=lambda end: (counts[end.joint], offered[end.joint], -len(chain.path(end.joint))))
        for end in ends:
            if end is not hub:
                meeting = _meeting(end, hub, chain, q)
                if not _related(chain, end.joint, hub.joint) or not _locks(chain, meeting, q):
                    yield meeting


def _foremost(chain: ClosedChain, group: Sequence[Link]) -> Link:
    """Of frames that are held together: the one with most joints behind it, and there one that serves nothing else."""
    return max(group, key=lambda link: (len(chain.path(link.joint)), link.leaf))


def _related(chain: ClosedChain, a: int, b: int) -> bool:
    """Whether one of two joints (BASE: the base) carries the other."""
    return a == BASE or b == BASE or a in chain.path(b) or b in chain.path(a)


def _locks(chain: ClosedChain, meeting: Meeting, q: np.ndarray) -> bool:
    """Whether a joint between the two frames could no longer move if they met."""
    closed = with_loops(chain, [meeting], "point")
    paths = [set(chain.path(end.joint)) for end in meeting.ends]
    between = sorted(paths[0] ^ paths[1])
    jacobian = loop_jacobian(closed, tree(closed, q[None]))[0][:, between]
    _, singular, right = np.linalg.svd(jacobian)
    rank = int(np.count_nonzero(singular > _LOCKED * max(singular[0], 1e-12)))
    return bool(np.any(np.linalg.norm(right[rank:], axis=0) < _LOCKED))


def paired(chain: ClosedChain, links: Sequence[Link]) -> Iterator[list[Meeting]]:
    """Guesses for a drawing that is not closed: the frames of one body, each with the end of a branch.

    A pair has the same numbers and sides in its names, or else the least distance; the body with most frames to offer
    comes first. Squares of distances don't mind that the body is drawn elsewhere as a whole.
    """
    from scipy.optimize import linear_sum_assignment

    q = chain.home
    at = dict(zip((link.name for link in links), _positions(links, tree(chain, q[None]))[0], strict=True))
    size = size_of(chain, links)
    leaves = [link for link in links if link.leaf]
    offered = Counter(link.joint for link in leaves)
    for joint, count in sorted(offered.items(), key=lambda item: (-item[1], item[0] == BASE)):
        tips = [link for link in leaves if link.joint not in chain.parents and link.joint not in (joint, BASE)]
        if joint != BASE:
            tips = [link for link in tips if not _related(chain, link.joint, joint)]
        ends = list(dict.fromkeys(link.joint for link in tips))
        if count < 2 or len(ends) < 2:
            continue
        hubs = [link for link in leaves if link.joint == joint]
        best = [[min((_cost(tip, hub, at, size), tip.name, tip) for tip in tips if tip.joint == end) for end in ends]
                for hub in hubs]  # fmt: skip
        rows, columns = linear_sum_assignment([[cost for cost, *_ in row] for row in best])
        yield _named([_meeting(best[i][k][2], hubs[i], chain, q) for i, k in zip(rows, columns, strict=True)])


def nearest_pairs(chain: ClosedChain, links: Sequence[Link], n: int) -> list[Meeting]:
    """Ends of different branches that may meet: those with names alike, then the nearest."""
    q = chain.home
    at = dict(zip((link.name for link in links), _positions(links, tree(chain, q[None]))[0], strict=True))
    ends = [link for link in links if link.leaf and link.joint != BASE and link.joint not in chain.parents]
    pairs = [(a, b) for a, b in combinations(ends[:200], 2) if not _related(chain, a.joint, b.joint)]
    pairs.sort(key=lambda pair: _cost(*pair, at, size_of(chain, links)))
    return _named([_meeting(a, b, chain, q) for a, b in pairs[:n]])


def _cost(tip: Link, hub: Link, at: dict[str, np.ndarray], size: float) -> float:
    alike = _marks(tip.name) == _marks(hub.name) != ((), frozenset())
    return float(np.sum((at[tip.name] - at[hub.name]) ** 2)) / size**2 + (0.0 if alike else 1e3)


def _marks(name: str) -> tuple[tuple[int, ...], frozenset[str]]:
    """What tells the legs of a robot apart: the numbers in a name, and words for sides."""
    words = re.split(r"[^a-z0-9]+", name.lower())
    sides = (word for word in words if word in _SIDES or (len(word) == 1 and word.isalpha()))
    return tuple(map(int, re.findall(r"\d+", name))), frozenset(sides)


def _meeting(end: Link, hub: Link, chain: ClosedChain, q: np.ndarray) -> Meeting:
    frames = tree(chain, q[None])
    first, second = (_pose(link, frames) for link in (end, hub))
    gap = float(np.linalg.norm(second.translation - first.translation))
    return Meeting("", (end, hub), gap, float(np.linalg.norm(log(first.rotation.T @ second.rotation))))


def _pose(link: Link, frames: Tree) -> Motion:
    placed = link.placement
    return Motion(frames.turned(link.joint, placed.rotation)[0], frames.point(link.joint, placed.translation)[0])


def _positions(links: Sequence[Link], frames: Tree) -> np.ndarray:
    """(n, n_links, 3) [m] in the world."""
    return np.stack([frames.point(link.joint, link.placement.translation) for link in links], axis=1)


def _named(meetings: list[Meeting]) -> list[Meeting]:
    """With a name each: the leg's, as its end has it (leg1_tip: leg1), where these differ."""
    stems = [re.match(r"[A-Za-z]+[_-]?\d+(?:[_-][A-Za-z]+\d+)*", m.ends[0].name) for m in meetings]
    names = [stem[0] if stem else "" for stem in stems]
    if "" in names or len(set(names)) < len(names) or max(map(len, names), default=0) > 40:
        names = [f"loop{k}" for k in range(1, len(meetings) + 1)]
    return [replace(m, name=name) for m, name in zip(meetings, names, strict=True)]


def random_configurations(chain: ClosedChain, n: int, seed: int) -> np.ndarray:
    """(n, n_joints) within the joint limits, where there are none within half a turn or a metre of the drawing."""
    low = np.where(np.isfinite(chain.lower), chain.lower, chain.drawn - np.where(chain.prismatic, 1.0, np.pi))
    high = np.where(np.isfinite(chain.upper), chain.upper, low + np.where(chain.prismatic, 2.0, 2 * np.pi))
    return np.random.default_rng(seed).uniform(np.minimum(low, high), np.maximum(low, high), (n, chain.n_joints))


def with_loops(chain: ClosedChain, meetings: Sequence[Meeting], kind: str) -> ClosedChain:
    """The chain with loops there, in addition to its own."""
    loops, n = [], len(chain.rotation)
    for k, meeting in enumerate(meetings):
        names = (meeting.ends[0].name, meeting.ends[1].name)
        joints = (meeting.ends[0].joint, meeting.ends[1].joint)
        loops.append(LoopClosure(meeting.name, kind, names, joints, (n + 2 * k, n + 2 * k + 1)))
    placed = [end.placement for meeting in meetings for end in meeting.ends]
    rotation = np.concatenate([chain.rotation, *(p.rotation[None] for p in placed)])
    translation = np.concatenate([chain.translation, *(p.translation[None] for p in placed)])
    return replace(chain, loops=(*chain.loops, *loops), rotation=rotation, translation=translation)
