"""Is the workspace fit for calibration? Mobility, singularities, branches and joint limits; and poses in it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kincal.urdf.closed_chain import ClosedChain
from kincal.urdf.description import Workspace
from kincal.urdf.errors import InputError, quoted
from kincal.urdf.kinematics import (
    TOLERANCE,
    Closure,
    actuator_jacobian,
    forward,
    inverse,
    loop_jacobian,
    tool_coordinates,
    tree,
)
from kincal.urdf.over_constrained import dependent, what_to_do

AXES = ("x", "y", "z", "rx", "ry", "rz")  # of the tool coordinates
_GRID_POINTS = 1500


@dataclass(frozen=True)
class WorkspaceReport:
    mobility: int
    worst_condition: float
    worst_pose: str
    n_checked: int


def bounds(workspace: Workspace) -> np.ndarray:
    """(n_axes, 2) [m, rad], in the order of the chain's tool axes."""
    millimetres = np.array(list(workspace.translation_mm.values())).reshape(-1, 2)
    degrees = np.array(list(workspace.rotation_deg.values())).reshape(-1, 2)
    return np.concatenate([millimetres * 1e-3, np.deg2rad(degrees)])


def grid(workspace: Workspace, axes: tuple[int, ...], counts: list[int]) -> np.ndarray:
    """Tool coordinates (prod(counts), 6) on a uniform grid over the workspace, its faces included."""
    lines = [np.linspace(low, high, n) for (low, high), n in zip(bounds(workspace), counts, strict=True)]
    return _full(np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, len(axes)), axes)


def sample(
    workspace: Workspace, axes: tuple[int, ...], n: int, seed: int | list[int], even: bool = False
) -> np.ndarray:
    """Tool coordinates (n, 6) spread over the workspace: uniformly at random, or evenly (scrambled Sobol points)."""
    random = np.random.default_rng(seed)
    if even:
        from scipy.stats import qmc  # takes half a second to import

        unit = qmc.Sobol(len(axes), rng=random).random_base2(int(np.ceil(np.log2(max(n, 2)))))[:n]
    else:
        unit = random.random((n, len(axes)))
    low, high = bounds(workspace).T
    return _full(low + unit * (high - low), axes)


def _full(values: np.ndarray, axes: tuple[int, ...]) -> np.ndarray:
    u = np.zeros((len(values), 6))
    u[:, list(axes)] = values
    return u


def describe(u: np.ndarray, axes: tuple[int, ...]) -> str:
    """A pose as people read it: x = 12.3 mm, rz = -4.0 deg."""
    parts = [f"{AXES[a]} = {1e3 * u[a]:.1f} mm" if a < 3 else f"{AXES[a]} = {np.rad2deg(u[a]):.1f} deg" for a in axes]
    return ", ".join(parts)


def mobility(chain: ClosedChain) -> int:
    """Degrees of freedom at home: joints less the rank of the loop equations."""
    return chain.n_joints - (chain.n_equations - len(_void_at_home(chain)))


def _void_at_home(chain: ClosedChain) -> np.ndarray:
    return dependent(loop_jacobian(chain, tree(chain, chain.home[None]))[0])


def condition_numbers(chain: ClosedChain, q: np.ndarray) -> np.ndarray:
    """(n,) condition numbers of d(actuators) / d(tool coordinates), made free of units.

    Translations are measured in the chain's characteristic length, the ratio of the two kinds of columns' norms at
    home; likewise sliding against turning actuators. Infinite at a singularity.
    """
    home = _scaled(actuator_jacobian(chain, chain.home[None]), chain, None)[1]
    jacobian, _ = _scaled(actuator_jacobian(chain, q), chain, home)
    numbers = np.full(len(q), np.inf)
    finite = np.isfinite(jacobian).all(axis=(1, 2))
    singular = np.linalg.svd(jacobian[finite], compute_uv=False)
    small = np.maximum(singular[:, -1], 1e-14 * singular[:, 0])
    numbers[finite] = np.where(singular[:, -1] > 1e-12 * singular[:, 0], singular[:, 0] / small, np.inf)
    return numbers


def _scaled(jacobian: np.ndarray, chain: ClosedChain, scale: tuple[float, float] | None):
    turning = np.array(chain.tool_axes) >= 3
    sliding = chain.prismatic[chain.actuated]
    if scale is None:
        mean = np.nan_to_num(jacobian[0])
        column = _ratio(mean[:, turning], mean[:, ~turning])
        row = _ratio(mean[~sliding], mean[sliding])
    else:
        column, row = scale
    jacobian = jacobian * np.where(turning, 1.0, column) * np.where(sliding, row, 1.0)[:, None]
    return jacobian, (column, row)


def _ratio(first: np.ndarray, second: np.ndarray) -> float:
    if not first.size or not second.size or not np.any(first) or not np.any(second):
        return 1.0
    return float(np.sqrt(np.mean(first**2) / np.mean(second**2)))


def check_workspace(chain: ClosedChain, workspace: Workspace) -> WorkspaceReport:
    """Refuse a robot that can't be calibrated in its workspace; the pose, joint or number is named (InputError)."""
    free, void = mobility(chain), _void_at_home(chain)
    if len(void):
        raise InputError(what_to_do(chain, void))
    for counted, count in (("actuated joints", len(chain.actuated)), ("axes in [workspace]", len(chain.tool_axes))):
        if count != free:
            raise InputError(f"mobility: the mechanism has {free} degrees of freedom at home, but {count} {counted}")
    axes = chain.tool_axes
    per_axis = next(k for k in (11, 9, 7, 5, 4, 3) if k ** len(axes) <= _GRID_POINTS or k == 3)
    _check_condition(chain, workspace, np.zeros((1, 6)), chain.home[None])
    corners = grid(workspace, axes, [2] * len(axes))
    _require_reached(chain, inverse(chain, corners), corners)  # few poses: what is hopeless is soon refused
    u = grid(workspace, axes, [per_axis] * len(axes))
    closure = inverse(chain, u)
    _require_reached(chain, closure, u)
    worst, where = _check_condition(chain, workspace, u, closure.q)
    check_limits(chain, closure.q, lambda row: f"workspace: pose ({describe(u[row], axes)})")
    back = forward(chain, closure.q[:, chain.actuated])
    apart = np.abs(tool_coordinates(chain, back.pose) - tool_coordinates(chain, closure.pose)).max(axis=1)
    other = np.flatnonzero(~back.closed | (apart > 1e-6))
    if len(other):
        raise InputError(
            f"workspace: pose ({describe(u[other[0]], axes)}): the actuators' values belong to another assembly branch "
            "as well; shrink the workspace"
        )
    return WorkspaceReport(free, worst, where, len(u))


def _require_reached(chain: ClosedChain, closure: Closure, u: np.ndarray) -> None:
    if closure.closed.all():
        return
    row = int(np.flatnonzero(~closure.closed)[0])
    pose = describe(u[row], chain.tool_axes)
    if closure.residual[row] < TOLERANCE:
        raise InputError(f"workspace: pose ({pose}) lies behind a singularity, on another assembly branch; shrink it")
    raise InputError(f"workspace: pose ({pose}) can't be reached (residual {closure.residual[row]:.3g} m or rad)")


def _check_condition(chain: ClosedChain, workspace: Workspace, u: np.ndarray, q: np.ndarray) -> tuple[float, str]:
    numbers = condition_numbers(chain, q)
    row = int(np.argmax(numbers))
    pose = describe(u[row], chain.tool_axes)
    if numbers[row] > workspace.max_condition:
        raise InputError(
            f"workspace: pose ({pose}) is singular: condition number {numbers[row]:.3g}, "
            f"allowed is max_condition = {workspace.max_condition:g}"
        )
    return float(numbers[row]), pose


def check_limits(chain: ClosedChain, q: np.ndarray, name_of_row) -> None:
    """Refuse configurations q: (n, n_joints) beyond the URDF's joint limits; name_of_row(row) begins the message."""
    for row, message in sorted(beyond_limits(chain, q).items()):
        raise InputError(f"{name_of_row(row)}: {message}")


def beyond_limits(chain: ClosedChain, q: np.ndarray) -> dict[int, str]:
    """{row: the first joint that is beyond the URDF's limits there} of configurations q: (n, n_joints)."""
    outside = np.argwhere((q < chain.lower - 1e-9) | (q > chain.upper + 1e-9))
    return {
        int(row): f"joint {quoted(chain.joint_names[j])} would be at {q[row, j]:.6g}; "
        f"its limits are [{chain.lower[j]:.6g}, {chain.upper[j]:.6g}]"
        for row, j in outside[::-1]  # so that the first of a row stays
    }
