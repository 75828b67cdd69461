"""Loop closure by Newton, forward and inverse kinematics, Jacobians: all poses at once, one path for any robot.

Joint values are q: (n, n_joints) [rad or m]. Tool coordinates are u: (n, 6), translation [m] of the tool from its home
pose along the base axes, and intrinsic XYZ angles [rad] of home orientation^T * orientation.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from kincal.urdf.closed_chain import BASE, ClosedChain, LoopClosure
from kincal.urdf.errors import InputError
from kincal.urdf.over_constrained import RANK_TOLERANCE, dependent, what_to_do
from kincal.urdf.rigid_motion import Motion, cross, from_xyz_angles, skew, vee, wrap, xyz_angles, xyz_rates

TOLERANCE = 1e-11  # of a closed loop and of a reached tool coordinate [m, rad]
_ITERATIONS = 12
_STEP = 0.6  # longest step of one joint in one Newton iteration [rad, m]
_ROUNDING = 1e-4  # loops that stay open by less, and are not independent, were drawn with rounded numbers [m, rad]
_CONTINUATION = (4, 16, 64)  # steps from home, tried in turn where the direct way fails


@dataclass(frozen=True)
class Tree:
    """Every joint's frame in the world, after forward kinematics of the spanning tree."""

    rotation: list[np.ndarray]  # of (n, 3, 3)
    translation: list[np.ndarray]  # of (n, 3)

    def point(self, joint: int, at: np.ndarray) -> np.ndarray:
        """(n, 3): a point that hangs on `joint` (BASE: on the base), in the world."""
        if joint == BASE:
            return np.broadcast_to(at, self.translation[0].shape)
        return _after(self.rotation[joint], self.translation[joint], at)

    def turned(self, joint: int, rotation: np.ndarray) -> np.ndarray:
        """(n, 3, 3): a frame's orientation that hangs on `joint` (BASE: on the base), in the world."""
        if joint == BASE:
            return np.broadcast_to(rotation, self.rotation[0].shape)
        return _times(self.rotation[joint], rotation)


@dataclass(frozen=True)
class Closure:
    """Configurations of the chain, and whether each one closes its loops on home's assembly branch."""

    q: np.ndarray  # (n, n_joints)
    pose: Motion  # of the tool in the base frame
    closed: np.ndarray  # (n,) bool
    residual: np.ndarray  # (n,) the largest loop (and target) error left [m, rad]

    def __getitem__(self, rows: np.ndarray) -> Closure:
        return Closure(self.q[rows], self.pose[rows], self.closed[rows], self.residual[rows])

    def replaced(self, rows: np.ndarray, other: Closure) -> Closure:
        """This closure with `other` in its rows (k,)."""
        rotation = _placed(self.pose.rotation, rows, other.pose.rotation)
        translation = _placed(self.pose.translation, rows, other.pose.translation)
        return Closure(
            _placed(self.q, rows, other.q),
            Motion(rotation, translation),
            _placed(self.closed, rows, other.closed),
            _placed(self.residual, rows, other.residual),
        )

    def require(self, name_of_row: Callable[[int], str]) -> Closure:
        """This closure, if every row is closed; else InputError that begins with name_of_row(row)."""
        if not self.closed.all():
            row = int(np.flatnonzero(~self.closed)[0])
            raise InputError(
                f"{name_of_row(row)}: the loops can't be closed there (residual {self.residual[row]:.3g} m or rad)"
            )
        return self


def _placed(array: np.ndarray, rows: np.ndarray, values: np.ndarray) -> np.ndarray:
    array = array.copy()
    array[rows] = values
    return array


def _times(batch: np.ndarray, constant: np.ndarray) -> np.ndarray:
    """batch (n, 3, 3) @ constant (3,) or (3, 3), as one product: five times as fast as n small ones."""
    return (batch.reshape(-1, 3) @ constant).reshape(len(batch), *constant.shape)


def _after(rotation: np.ndarray, translation: np.ndarray, point: np.ndarray) -> np.ndarray:
    return _times(rotation, point) + translation


def tree(chain: ClosedChain, q: np.ndarray) -> Tree:
    """Forward kinematics of the spanning tree, q: (n, n_joints)."""
    n = len(q)
    rotation, translation = [], []
    for j, parent in enumerate(chain.parents):
        placed, at, axis = chain.rotation[j], chain.translation[j], chain.axes[j]
        origin = np.broadcast_to(at, (n, 3)) if parent == BASE else _after(rotation[parent], translation[parent], at)
        if chain.prismatic[j]:
            local = placed
            direction = placed @ axis
            origin = origin + q[:, j, None] * (direction if parent == BASE else _times(rotation[parent], direction))
        else:  # Rodrigues' formula, with the placement multiplied in
            turn = skew(axis)
            terms = np.stack([placed @ (np.eye(3) + turn @ turn), placed @ turn, -placed @ turn @ turn])
            weights = np.stack([np.ones(n), np.sin(q[:, j]), np.cos(q[:, j])], axis=1)
            local = (weights @ terms.reshape(3, 9)).reshape(n, 3, 3)
        if parent == BASE:
            rotation.append(np.broadcast_to(local, (n, 3, 3)))
        else:
            rotation.append(_times(rotation[parent], local) if local.ndim == 2 else rotation[parent] @ local)
        translation.append(origin)
    return Tree(rotation, translation)


def _twist_columns(chain: ClosedChain, frames: Tree, joint: int, point: np.ndarray) -> tuple[list[int], np.ndarray]:
    """The joints that carry `point` (n, 3) on `joint`, and d(velocity, angular velocity) / dq: (n, 6, len(joints))."""
    path = chain.path(joint)
    columns = np.zeros((len(point), 6, len(path)))
    for k, j in enumerate(path):
        axis = _times(frames.rotation[j], chain.axes[j])
        if chain.prismatic[j]:
            columns[:, :3, k] = axis
        else:
            columns[:, :3, k] = cross(axis, point - frames.translation[j])
            columns[:, 3:, k] = axis
    return path, columns


def _meeting_points(chain: ClosedChain, frames: Tree, loop: LoopClosure) -> list[np.ndarray]:
    ends = zip(loop.joints, loop.bodies, strict=True)
    return [frames.point(joint, chain.translation[body]) for joint, body in ends]


def _relative_rotation(chain: ClosedChain, frames: Tree, loop: LoopClosure) -> tuple[np.ndarray, np.ndarray]:
    """The first frame's orientation, transposed, and the second's in the first: (n, 3, 3) each."""
    ends = zip(loop.joints, loop.bodies, strict=True)
    first, second = (frames.turned(joint, chain.rotation[body]) for joint, body in ends)
    first = np.swapaxes(first, -1, -2)
    return first, first @ second


def loop_error(chain: ClosedChain, frames: Tree) -> np.ndarray:
    """(n, n_equations): second minus first frame of every loop, in the world [m]; for a frame loop also the
    sine-weighted rotation vector from the first to the second, in the first [rad]."""
    errors = [np.zeros((len(frames.translation[0]), 0))]
    for loop in chain.loops:
        first, second = _meeting_points(chain, frames, loop)
        errors.append(second - first)
        if loop.kind == "frame":
            errors.append(vee(_relative_rotation(chain, frames, loop)[1]))
    return np.concatenate(errors, axis=1)


def loop_jacobian(chain: ClosedChain, frames: Tree) -> np.ndarray:
    """(n, n_equations, n_joints): d(loop_error) / dq, exact."""
    jacobian = np.zeros((len(frames.translation[0]), chain.n_equations, chain.n_joints))
    row = 0
    for loop in chain.loops:
        turn = None
        if loop.kind == "frame":
            first, relative = _relative_rotation(chain, frames, loop)
            # d vee(E - E^T)/2 = (tr(E) I - E) a / 2 for dE = [a] E, a the relative rate in the first frame
            turn = 0.5 * (np.trace(relative, axis1=1, axis2=2)[:, None, None] * np.eye(3) - relative) @ first
        for sign, joint, point in zip((-1, 1), loop.joints, _meeting_points(chain, frames, loop), strict=True):
            path, columns = _twist_columns(chain, frames, joint, point)
            jacobian[:, row : row + 3, path] += sign * columns[:, :3]
            if turn is not None:
                jacobian[:, row + 3 : row + 6, path] += sign * (turn @ columns[:, 3:])
        row += loop.rows
    return jacobian


def tool_pose(chain: ClosedChain, frames: Tree) -> Motion:
    """The tool's pose in the base frame."""
    joint, placed = chain.tool_joint, chain.tool
    return chain.base.inverse() @ Motion(frames.turned(joint, placed.rotation), frames.point(joint, placed.translation))


def tool_coordinates(chain: ClosedChain, pose: Motion) -> np.ndarray:
    """u: (n, 6) of tool poses in the base frame."""
    home = chain.home_pose
    return np.concatenate([pose.translation - home.translation, xyz_angles(home.rotation.T @ pose.rotation)], axis=-1)


def pose_at(chain: ClosedChain, u: np.ndarray) -> Motion:
    """Tool poses in the base frame at coordinates u: (n, 6): the inverse of `tool_coordinates`."""
    home = chain.home_pose
    return Motion(home.rotation @ from_xyz_angles(u[..., 3:]), home.translation + u[..., :3])


def tool_jacobian(chain: ClosedChain, frames: Tree) -> np.ndarray:
    """(n, 6, n_joints): d(tool coordinates) / dq, the loops left open."""
    path, columns = _twist_columns(
        chain, frames, chain.tool_joint, frames.point(chain.tool_joint, chain.tool.translation)
    )
    to_base = chain.base.rotation.T
    angles = tool_coordinates(chain, tool_pose(chain, frames))[:, 3:]
    jacobian = np.zeros((len(columns), 6, chain.n_joints))
    jacobian[:, :3, path] = to_base @ columns[:, :3]
    jacobian[:, 3:, path] = xyz_rates(angles) @ (chain.home_pose.rotation.T @ to_base) @ columns[:, 3:]
    return jacobian


@dataclass(frozen=True)
class _Problem:
    """Equations f(q, target) = 0 for the joints `unknown`; the other joints are set to the target."""

    chain: ClosedChain
    unknown: np.ndarray
    axes: tuple[int, ...]  # the tool coordinates among the equations

    def place(self, q: np.ndarray, target: np.ndarray) -> np.ndarray:
        q = q.copy()
        if not self.axes:
            q[:, self.chain.actuated] = target
        return q

    def error(self, frames: Tree, target: np.ndarray) -> np.ndarray:
        error = loop_error(self.chain, frames)
        if not self.axes:
            return error
        axes = list(self.axes)
        offset = tool_coordinates(self.chain, tool_pose(self.chain, frames))[:, axes] - target
        angles = np.array(axes) >= 3
        offset[:, angles] = wrap(offset[:, angles])
        return np.concatenate([error, offset], axis=1)

    def jacobian(self, frames: Tree) -> np.ndarray:
        jacobian = loop_jacobian(self.chain, frames)
        if self.axes:
            jacobian = np.concatenate([jacobian, tool_jacobian(self.chain, frames)[:, list(self.axes)]], axis=1)
        return jacobian[:, :, self.unknown]


def forward(chain: ClosedChain, actuated: np.ndarray, start: np.ndarray | None = None, direct: bool = False) -> Closure:
    """Joints to tool: close the loops at actuated joint values (n, n_actuated) [rad or m].

    start: (n, n_joints), closed configurations near by where they are known (their branch is kept);
    otherwise home's branch is followed. direct: rows that Newton's method does not close at once stay open; else they
    are approached from home in steps.
    """
    problem = _Problem(chain, chain.passive, ())
    return _solve(problem, np.asarray(actuated, dtype=float), chain.home[chain.actuated], start, direct)


def inverse(chain: ClosedChain, u: np.ndarray, start: np.ndarray | None = None) -> Closure:
    """Tool to joints: the configurations on home's branch with tool coordinates u: (n, 6) on the chain's tool axes.

    The other coordinates of u are not looked at: the mechanism decides them.
    start: (n, n_joints), closed configurations near by where they are known (their branch is kept).
    """
    problem = _Problem(chain, np.arange(chain.n_joints), chain.tool_axes)
    axes = list(chain.tool_axes)
    home = tool_coordinates(chain, tool_pose(chain, tree(chain, chain.home[None])))[0, axes]
    return _solve(problem, np.asarray(u, dtype=float)[:, axes], home, start)


def _solve(
    problem: _Problem, target: np.ndarray, home_target: np.ndarray, start: np.ndarray | None, direct: bool = False
) -> Closure:
    chain = problem.chain
    q = np.tile(chain.home, (len(target), 1)) if start is None else start
    branch = np.linalg.slogdet(problem.jacobian(tree(chain, chain.home[None])))[0][0]
    closure = _newton(problem, q, target, branch)
    for steps in () if direct else _CONTINUATION:
        todo = np.flatnonzero(~closure.closed)
        if not len(todo):
            break
        path = np.tile(chain.home, (len(todo), 1))
        for fraction in np.linspace(0, 1, steps + 1)[1:]:
            here = home_target + fraction * (target[todo] - home_target)
            again = _newton(problem, path, here, branch)
            path = again.q
        closure = closure.replaced(todo, again)
    return closure


def _newton(problem: _Problem, q: np.ndarray, target: np.ndarray, branch: float) -> Closure:
    """Newton's method with a limited step, for the rows that need it.

    branch: the sign of the Jacobian's determinant at home; a row that ends with the other sign has crossed a
    singularity. A row takes its last step when its error is so small (1e-7) that the quadratic step ends at rounding;
    that is verified for all rows at the end.
    """
    chain, unknown = problem.chain, problem.unknown
    q = problem.place(q, target)
    sign = np.full(len(q), branch if not len(unknown) else 0.0)
    active = np.arange(len(q)) if len(unknown) else np.arange(0)
    for _ in range(_ITERATIONS):
        if not len(active):
            break
        frames = tree(chain, q[active])
        error = problem.error(frames, target[active])
        jacobian = problem.jacobian(frames)
        step = _linear_solve(jacobian, error[..., None])[..., 0]
        longest = np.max(np.abs(step), axis=1)
        q[np.ix_(active, unknown)] -= step * np.minimum(1.0, _STEP / np.maximum(longest, 1e-300))[:, None]
        done = np.max(np.abs(error), axis=1) < 1e-7
        if done.any():
            sign[active[done]] = np.linalg.slogdet(jacobian[done])[0]
            active = active[~done]
    frames = tree(chain, q)
    residual = np.max(np.abs(problem.error(frames, target)), axis=1, initial=0.0)
    pose = tool_pose(chain, frames)
    return Closure(q, pose, (residual < TOLERANCE) & ((sign == branch) | (branch == 0)), residual)


def _linear_solve(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    try:
        return np.linalg.solve(matrix, right)
    except np.linalg.LinAlgError:  # a row that is exactly singular would take the whole batch down
        finite = np.where(np.isfinite(matrix), matrix, 0.0)
        return np.linalg.pinv(finite, rcond=1e-9) @ np.where(np.isfinite(right), right, 0.0)


def at_home(chain: ClosedChain, pose: Motion | None, seed: int = 0, attempts: int = 40) -> ClosedChain:
    """The chain with its home configuration and home pose set: the tool put at `pose`, the actuators free.

    pose: in the base frame; None: the tool's pose in the configuration that the file shows. Damped Gauss-Newton from
    the chain's first guess, then from random configurations within the joint limits.
    Raises InputError that names the loop that stays open.
    """
    if pose is None:
        pose = tool_pose(chain, tree(chain, chain.drawn[None]))[0]
    chain = replace(chain, home_pose=pose)
    problem = _Problem(chain, np.arange(chain.n_joints), chain.tool_axes)
    random = np.random.default_rng(seed)
    low = np.where(np.isfinite(chain.lower), chain.lower, -np.pi)
    high = np.where(np.isfinite(chain.upper), chain.upper, np.pi)
    best = (np.inf, chain.home)
    for attempt in range(attempts):
        start = (
            chain.home
            if attempt == 0
            else chain.home + min(1.0, attempt / 20) * random.uniform(low - high, high - low) / 2
        )
        q, residual = _damped(problem, np.clip(start, low, high))
        if residual < TOLERANCE and not np.all((q >= chain.lower) & (q <= chain.upper)):
            residual = 1.0  # closed, but outside the limits: keep looking
        if residual < best[0]:
            best = (residual, q)
        if best[0] < TOLERANCE:
            return replace(chain, home=best[1])
    raise InputError(_why_no_home(problem, best[1]))


def _damped(problem: _Problem, q: np.ndarray) -> tuple[np.ndarray, float]:
    """Levenberg-Marquardt on one configuration, for starts that are far from home."""
    target = np.zeros((1, len(problem.axes)))
    damping, error = 1e-3, problem.error(tree(problem.chain, q[None]), target)[0]
    for _ in range(100):
        if np.max(np.abs(error)) < 1e-14 or damping > 1e8:
            break
        jacobian = problem.jacobian(tree(problem.chain, q[None]))[0]
        stacked = np.concatenate([jacobian, np.sqrt(damping) * np.eye(len(q))])
        step = np.linalg.lstsq(stacked, np.concatenate([error, np.zeros(len(q))]), rcond=None)[0]
        step *= min(1.0, _STEP / max(np.max(np.abs(step)), 1e-300))
        trial = problem.error(tree(problem.chain, (q - step)[None]), target)[0]
        if np.linalg.norm(trial) < np.linalg.norm(error):
            q, error, damping = q - step, trial, max(damping / 10, 1e-15)
        else:
            damping *= 10
    return q, float(np.max(np.abs(error)))


def _why_no_home(problem: _Problem, q: np.ndarray) -> str:
    chain = problem.chain
    outside = np.flatnonzero((q < chain.lower) | (q > chain.upper))
    error = np.abs(problem.error(tree(chain, q[None]), np.zeros((1, len(problem.axes))))[0])
    if error.max() < TOLERANCE and len(outside):
        j = outside[0]
        return (
            f"workspace: with the tool at home, joint {chain.joint_names[j]!r} would be at {q[j]:.4g}; "
            f"its limits are [{chain.lower[j]:.4g}, {chain.upper[j]:.4g}]"
        )
    row = 0
    worst = ("the tool's home pose", error[chain.n_equations :].max(initial=0.0))
    for loop in chain.loops:
        size = error[row : row + loop.rows].max()
        worst = max(worst, (f"loop {loop.name!r} ({loop.frames[0]} and {loop.frames[1]})", size), key=lambda w: w[1])
        row += loop.rows
    why = f"with the tool at home the loops can't be closed: {worst[0]} stays open by {worst[1]:.4g} m or rad"
    if worst[1] > _ROUNDING or not chain.n_equations:
        return why
    void = dependent(loop_jacobian(chain, tree(chain, q[None]))[0], max(RANK_TOLERANCE, 10 * worst[1]))
    return f"{why}; {what_to_do(chain, void)}" if len(void) else why


def passive_rates(chain: ClosedChain, q: np.ndarray) -> np.ndarray:
    """(n, n_joints, n_actuated): d(all joints) / d(actuated joints), the loops kept closed."""
    rates = np.zeros((len(q), chain.n_joints, len(chain.actuated)))
    rates[:, chain.actuated] = np.eye(len(chain.actuated))
    if chain.n_equations:
        jacobian = loop_jacobian(chain, tree(chain, q))
        rates[:, chain.passive] = -np.linalg.solve(jacobian[:, :, chain.passive], jacobian[:, :, chain.actuated])
    return rates


def tool_rates(chain: ClosedChain, q: np.ndarray) -> np.ndarray:
    """(n, 6, n_tool_axes): d(tool coordinates) / d(those on the chain's tool axes), the loops kept closed."""
    problem = _Problem(chain, np.arange(chain.n_joints), chain.tool_axes)
    frames = tree(chain, q)
    right = np.zeros((len(q), chain.n_joints, len(chain.tool_axes)))
    right[:, chain.n_equations :] = np.eye(len(chain.tool_axes))
    return tool_jacobian(chain, frames) @ _linear_solve(problem.jacobian(frames), right)


def tool_point_jacobian(chain: ClosedChain, q: np.ndarray, point: np.ndarray) -> np.ndarray:
    """(n, 3, n_joints): d(world position) / dq of a point (3,) [m] of the tool frame, the loops left open."""
    on_joint = chain.tool.rotation @ point + chain.tool.translation
    return point_jacobian(chain, tree(chain, q), chain.tool_joint, on_joint)


def point_jacobian(chain: ClosedChain, frames: Tree, joint: int, point: np.ndarray) -> np.ndarray:
    """(n, 3, n_joints): the same of a point (3,) [m] that hangs on `joint`."""
    at = frames.point(joint, point)
    path, columns = _twist_columns(chain, frames, joint, at)
    jacobian = np.zeros((len(at), 3, chain.n_joints))
    jacobian[:, :, path] = columns[:, :3]
    return jacobian


def actuator_jacobian(chain: ClosedChain, q: np.ndarray) -> np.ndarray:
    """(n, n_actuated, n_tool_axes): d(actuated joints) / d(tool coordinates), the loops kept closed.

    NaN where the configuration is singular in that direction.
    """
    problem = _Problem(chain, np.arange(chain.n_joints), chain.tool_axes)
    jacobian = problem.jacobian(tree(chain, q))
    right = np.zeros((len(q), chain.n_joints, len(chain.tool_axes)))
    right[:, chain.n_equations :] = np.eye(len(chain.tool_axes))
    try:
        return np.linalg.solve(jacobian, right)[:, chain.actuated]
    except np.linalg.LinAlgError:
        return np.full((len(q), len(chain.actuated), len(chain.tool_axes)), np.nan)
