"""The full-parameter error model: CasADi, walked once from the closed chain that the Pinocchio model gave.

Every joint placement (6 numbers), both frames of every loop (3 each for a point loop, 6 for a frame loop), every
actuator's zero and gain, and both measurement frames may be wrong. Predicted = W * tool pose * T, with W (base to
instrument, `instrument`) and T (tool to target, `target`). Passive joints follow from phi(q_active, q_passive, p) = 0:

    d q_passive / d p = -(d phi / d q_passive)^-1 (d phi / d p)      (Huang et al. 2019, Mech. Mach. Theory 131)
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import lru_cache

import casadi as ca
import numpy as np

from kincal.identification.channels import named
from kincal.identification.compiled import PAYS, compiled
from kincal.identification.measurements import Measurements
from kincal.identification.symbolic_chain import after, joint_frames, loop_equations, tool_placement
from kincal.urdf.actuators import Actuators
from kincal.urdf.closed_chain import ClosedChain
from kincal.urdf.description import Actuator, Tolerance
from kincal.urdf.errors import InputError
from kincal.urdf.kinematics import Closure, forward
from kincal.urdf.rigid_motion import Motion, exp, right_jacobian

_COORDINATES = ("x", "y", "z", "rx", "ry", "rz")
FRAMES = ("instrument", "target")  # W and T
_CHUNK = 1000  # poses differentiated at once

Weigh = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Parameters:
    """The names of p, its order, its units, its nominal values and its priors: arrays of n_parameters.

    p holds changes from nominal. A placement's position is nominal + change in its parent joint's frame [m]; its
    orientation is nominal * exp(rotation vector in its own frame [rad]), so the nominal of a rotation is 0.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    nominal: np.ndarray
    tolerance: np.ndarray  # one sigma; infinite for W and T, whose priors are flat

    @property
    def flat(self) -> np.ndarray:
        return ~np.isfinite(self.tolerance)

    def __len__(self) -> int:
        return len(self.names)


@dataclass(frozen=True)
class BuiltRobot:
    """A robot with given parameters: what it is, not how it was found."""

    chain: ClosedChain
    actuators: Actuators
    instrument: Motion  # W
    target: Motion  # T

    def close(self, readings: np.ndarray, start: np.ndarray | None = None, shift: np.ndarray | float = 0.0) -> Closure:
        """The closed configurations at readings (n, n_actuated); start: (n, n_joints) near by, where known.

        shift: (n, n_actuated) of the joints, beside what the actuators' zeros and gains say.
        """
        return forward(self.chain, self.actuators.joints(readings) + shift, start)

    def measured(self, tool: Motion) -> Motion:
        """A tool pose as the instrument sees it: W * tool pose * T."""
        return self.instrument @ tool @ self.target


@dataclass(frozen=True)
class Linearisation:
    """Whitened residuals at one parameter vector, and how they change: |J s + r| = |triangle (s, 1)| for every step s.

    The triangle of a QR factorisation is streamed over the poses: J itself, (n rows, n_parameters), is never held, nor
    are normal equations, which would square its condition number.
    """

    residual: np.ndarray  # (n, rows a pose)
    triangle: np.ndarray  # (at most n_parameters + 1, n_parameters + 1) of (J, r), each row weighted
    q: np.ndarray  # (n, n_joints) the closed configurations
    by_instrument: np.ndarray  # (n, rows a pose, 3): J's columns of W's translation, unweighted


@dataclass(frozen=True)
class ErrorModel:
    """Residuals of measurements and their exact derivatives, for any robot and any mix of channels."""

    chain: ClosedChain  # nominal
    actuators: Actuators  # nominal
    parameters: Parameters
    _functions: dict = field(default_factory=dict, repr=False, compare=False)

    @staticmethod
    def of(chain: ClosedChain, settings: Mapping[str, Actuator], tolerance: Tolerance) -> ErrorModel:
        actuators = Actuators.nominal(chain, settings)
        return ErrorModel(chain, actuators, _parameters(chain, actuators, tolerance))

    def robot(self, p: np.ndarray) -> BuiltRobot:
        """The robot with parameter changes p: (n_parameters,)."""
        xi, zero, gain, frames = self._split(p)
        chain = self.chain
        moved = chain.with_geometry(chain.rotation @ exp(xi[:, 3:]), chain.translation + xi[:, :3])
        actuators = Actuators(self.actuators.gain + gain, self.actuators.zero + zero)
        return BuiltRobot(moved, actuators, *(Motion.from_vector(v) for v in frames))

    @property
    def zeros(self) -> slice:
        """The actuators' zeros among the parameters: (n_actuated,)."""
        n = len(self.actuators.gain)
        return slice(len(self.parameters) - 12 - 2 * n, len(self.parameters) - 12 - n)

    def with_frames(self, p: np.ndarray, instrument: Motion, target: Motion) -> np.ndarray:
        """p with W and T replaced."""
        return np.concatenate([p[:-12], instrument.vector(), target.vector()])

    def residual(self, robot: BuiltRobot, q: np.ndarray, measured: Measurements) -> np.ndarray:
        """Whitened residuals, predicted less measured: (n, rows a pose)."""
        return self._function(measured, "residual")(robot, q, measured)[0]

    def linearise(
        self, p: np.ndarray, measured: Measurements, start: np.ndarray | None = None, weigh: Weigh | None = None
    ) -> Linearisation | None:
        """Close the loops at p and differentiate through the closure; None where they can't be closed.

        start: (n, n_joints) configurations near by. weigh: residuals (n, rows a pose) -> weights of their squares.
        """
        robot, triangle = self.robot(p), np.zeros((0, len(p) + 1))
        residuals, configurations, columns = [], [], []
        for rows in _chunks(len(measured)):
            closure = robot.close(measured.readings[rows], None if start is None else start[rows])
            if not closure.closed.all():
                return None
            residual, jacobian = self._derivatives(robot, p, closure.q, measured[rows], len(measured) >= PAYS)
            block = np.concatenate([jacobian, residual[..., None]], axis=2)
            if weigh is not None:
                block *= np.sqrt(weigh(residual))[..., None]
            stacked = np.concatenate([triangle, block.reshape(-1, len(p) + 1)])
            triangle = np.asarray(np.linalg.qr(stacked, mode="r"))
            residuals.append(residual)
            configurations.append(closure.q)
            columns.append(jacobian[:, :, -12:-9])
        return Linearisation(
            np.concatenate(residuals), triangle, np.concatenate(configurations), np.concatenate(columns)
        )

    def jacobian(
        self, p: np.ndarray, measured: Measurements, q: np.ndarray | None = None, columns: slice = slice(None)
    ) -> np.ndarray:
        """(n, rows a pose, n_parameters): the whitened identification Jacobian at p; q: (n, n_joints) closed there."""
        robot = self.robot(p)
        q = robot.close(measured.readings).q if q is None else q
        parts = [self._derivatives(robot, p, q[k], measured[k])[1][:, :, columns] for k in _chunks(len(measured))]
        return np.concatenate(parts)

    def pose_jacobian(self, p: np.ndarray, readings: np.ndarray, q: np.ndarray) -> np.ndarray:
        """(n, 6, n_parameters): d(rotation in the target frame [rad], position [m]) / dp of predicted poses."""
        robot = self.robot(p)
        pose = robot.measured(robot.close(readings, q).pose)
        ones = np.ones(len(readings))
        values = {"orientation": pose.rotation, "position": pose.translation}
        itself = Measurements(np.arange(len(ones)), readings, values, dict.fromkeys(values, ones))
        return self._derivatives(robot, p, q, itself)[1]

    def _derivatives(
        self, robot: BuiltRobot, p: np.ndarray, q: np.ndarray, measured: Measurements, many: bool = False
    ) -> tuple[np.ndarray, np.ndarray]:
        kind = "compiled derivatives" if many else "derivatives"
        residual, r_q, r_x, phi_q, phi_x = self._function(measured, kind)(robot, q, measured)
        chain = self.chain
        if chain.n_equations:
            passive = chain.passive
            adjoint = np.linalg.solve(phi_q[:, :, passive].swapaxes(1, 2), r_q[:, :, passive].swapaxes(1, 2)).swapaxes(
                1, 2
            )
            r_q = r_q[:, :, chain.actuated] - adjoint @ phi_q[:, :, chain.actuated]
            r_x = r_x - adjoint @ phi_x
        else:
            r_q = r_q[:, :, chain.actuated]
        n_bodies = len(chain.rotation)
        r_x = _chain_rotations(r_x, p, self._split(p))
        bodies = r_x[:, :, : 6 * n_bodies][:, :, _kept(chain)]
        return residual, np.concatenate(
            [bodies, r_q, r_q * measured.readings[:, None, :], r_x[:, :, 6 * n_bodies :]], axis=2
        )

    def _split(self, p: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, tuple[np.ndarray, np.ndarray]]:
        """Placement changes (n_bodies, 6), zeros, gains, and the vectors of W and T."""
        kept, n = _kept(self.chain), len(self.actuators.gain)
        xi = np.zeros(6 * len(self.chain.rotation))
        xi[kept] = p[: len(kept)]
        zero, gain, frames = np.split(p[len(kept) :], [n, 2 * n])
        return xi.reshape(-1, 6), zero, gain, (frames[:6], frames[6:])

    def _function(self, measured: Measurements, kind: str) -> _Batched:
        key = (measured.channels, kind)
        if key not in self._functions:
            function = _symbolic(self.chain, measured.channels, kind != "residual")
            self._functions[key] = _Batched(compiled(function) if kind == "compiled derivatives" else function)
        return self._functions[key]


def _chunks(n: int) -> Iterator[slice]:
    return (slice(k, min(k + _CHUNK, n)) for k in range(0, n, _CHUNK))


def _kept(chain: ClosedChain) -> np.ndarray:
    """Of 6 numbers a body, those that are parameters: a point loop's frames have no orientation."""
    keep = np.ones((len(chain.rotation), 6), dtype=bool)
    for loop in chain.loops:
        if loop.kind == "point":
            keep[list(loop.bodies), 3:] = False
    return np.flatnonzero(keep)


def _parameters(chain: ClosedChain, actuators: Actuators, tolerance: Tolerance) -> Parameters:
    kept = _kept(chain)
    position, rotation = tolerance.position_mm * 1e-3, np.deg2rad(tolerance.rotation_deg)
    names = [f"{chain.body_names[k // 6]}.{_COORDINATES[k % 6]}" for k in kept]
    units = ["m" if k % 6 < 3 else "rad" for k in kept]
    nominal = np.concatenate([chain.translation, np.zeros((len(chain.translation), 3))], axis=1).ravel()[kept]
    sigma = np.where(kept % 6 < 3, position, rotation)
    joint_units = ["m" if chain.prismatic[j] else "rad" for j in chain.actuated]
    names += [f"{a}.zero" for a in chain.actuated_names] + [f"{a}.gain" for a in chain.actuated_names]
    units += joint_units + [f"{u}/reading" for u in joint_units]
    zero_mm, zero_deg = tolerance.actuator_zero_mm * 1e-3, np.deg2rad(tolerance.actuator_zero_deg)
    sigma_zero = np.where(chain.prismatic[chain.actuated], zero_mm, zero_deg)
    names += [f"{frame}.{c}" for frame in FRAMES for c in _COORDINATES]
    units += ["m", "m", "m", "rad", "rad", "rad"] * 2
    return Parameters(
        tuple(names),
        tuple(units),
        np.concatenate([nominal, actuators.zero, actuators.gain, np.zeros(12)]),
        np.concatenate([sigma, sigma_zero, tolerance.actuator_gain * np.abs(actuators.gain), np.full(12, np.inf)]),
    )


def _chain_rotations(r_x: np.ndarray, p: np.ndarray, split) -> np.ndarray:
    """From small rotations at the current orientation to changes of the rotation vectors in p."""
    xi, _, _, frames = split
    vectors = np.concatenate([xi, np.stack(frames)])[:, 3:]
    blocks = r_x.reshape(*r_x.shape[:2], -1, 6).copy()
    blocks[..., 3:] = np.einsum("nrbi,bij->nrbj", blocks[..., 3:], right_jacobian(vectors))
    return blocks.reshape(r_x.shape)


class _Batched:
    """One CasADi function for all poses: residuals, and on demand their derivatives, as dense arrays."""

    def __init__(self, function: ca.Function) -> None:
        self._function = function
        self._mapped = lru_cache(maxsize=4)(self._map)

    def _map(self, n: int) -> ca.Function:
        return self._function.map(f"poses{n}", "serial", n, [1], [])

    def __call__(self, robot: BuiltRobot, q: np.ndarray, measured: Measurements) -> list[np.ndarray]:
        n = len(q)
        function = self._mapped(n)
        buffer, run = function.buffer()
        frames = [_pack(m.rotation, m.translation) for m in (robot.instrument, robot.target)]
        constants = np.concatenate([_pack(robot.chain.rotation, robot.chain.translation), *frames])
        inputs = [np.ascontiguousarray(q, dtype=float), constants, _observations(measured)]
        for k, value in enumerate(inputs):
            buffer.set_arg(k, memoryview(value))  # pyright: ignore
        outputs = []
        for k in range(self._function.n_out()):
            outputs.append(np.zeros((n, self._function.nnz_out(k))))
            buffer.set_res(k, memoryview(outputs[-1]))  # pyright: ignore
        run()
        return [self._dense(k, values) for k, values in enumerate(outputs)]

    def _dense(self, k: int, values: np.ndarray) -> np.ndarray:
        sparsity = self._function.sparsity_out(k)
        rows, columns = sparsity.shape
        dense = np.zeros((len(values), rows * columns))
        row, column = sparsity.get_triplet()
        dense[:, np.array(row, dtype=int) * columns + np.array(column, dtype=int)] = values
        return dense if columns == 1 else dense.reshape(len(values), rows, columns)


def _pack(rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
    """Placements as one vector: 9 numbers column by column, then 3."""
    rotation, translation = np.atleast_3d(rotation).reshape(-1, 3, 3), np.atleast_2d(translation)
    return np.concatenate([rotation.swapaxes(1, 2).reshape(-1, 9), translation], axis=1).ravel()


def _observations(measured: Measurements) -> np.ndarray:
    """(n, columns): each channel's measured values and its sigma, in the order of `channels`."""
    columns = []
    for channel in named(measured.channels):
        columns += [channel.observed(measured.values[channel.name]), measured.std[channel.name][:, None]]
    return np.ascontiguousarray(np.concatenate(columns, axis=1), dtype=float)


def _symbolic(chain: ClosedChain, channels: tuple[str, ...], derivatives: bool) -> ca.Function:
    """The chain walked once: residuals of one pose, phi, and their derivatives by joints and by small errors."""
    n_bodies = len(chain.rotation)
    q, constants = ca.SX.sym("q", chain.n_joints), ca.SX.sym("placements", 12 * (n_bodies + 2))
    xi = ca.SX.sym("errors", 6 * (n_bodies + 2))
    placed = []
    for k in range(n_bodies + 2):
        numbers, error = constants[12 * k : 12 * k + 12], xi[6 * k : 6 * k + 6]
        turned = ca.reshape(numbers[:9], 3, 3) @ (ca.SX.eye(3) + ca.skew(error[3:]))
        placed.append((turned, numbers[9:] + error[:3]))
    frames = joint_frames(chain, q, placed)
    phi = loop_equations(chain, frames, placed)
    tool = tool_placement(chain, frames)
    rotation, translation = after(after(placed[-2], tool), placed[-1])
    residual, observed = _residual(channels, rotation, translation)
    outputs = [residual]
    if derivatives:
        outputs += [
            ca.jacobian(residual, q),
            ca.jacobian(residual, xi),
            ca.jacobian(phi, q),
            ca.jacobian(phi, xi[: 6 * n_bodies]),
        ]
        # W and T move no loop: their columns of d phi / d xi are zero, and stay so
        outputs[-1] = ca.horzcat(outputs[-1], ca.SX(phi.shape[0], 12))
    outputs = ca.substitute(outputs, [xi], [ca.SX.zeros(xi.shape)])
    return ca.Function("error_model", [q, constants, observed], outputs)


def _residual(channels: tuple[str, ...], rotation: ca.SX, translation: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Whitened residuals of one pose (predicted less measured), and the symbols of what was measured."""
    rows, symbols = [], []
    for channel in named(channels):
        value, sigma = ca.SX.sym(channel.name, channel.size), ca.SX.sym(f"{channel.name}_std")
        rows.append(channel.residual(rotation, translation, value) / sigma)
        symbols += [value, sigma]
    return ca.vertcat(*rows), ca.vertcat(*symbols)


@lru_cache
def _pose_residual(channels: tuple[str, ...]) -> ca.Function:
    rotation, translation = ca.SX.sym("rotation", 3, 3), ca.SX.sym("translation", 3)
    residual, observed = _residual(channels, rotation, translation)
    return ca.Function("pose_residual", [ca.vec(rotation), translation, observed], [residual])


def pose_residual(predicted: Motion, measured: Measurements) -> np.ndarray:
    """Whitened residuals (n, rows a pose) of predicted poses (n) in the measurement frame, whoever predicted them."""
    rotation = predicted.rotation.swapaxes(1, 2).reshape(-1, 9)
    function = _pose_residual(measured.channels)
    return np.array(function(rotation.T, predicted.translation.T, _observations(measured).T)).T


def require_closed(closure: Closure, measured: Measurements) -> Closure:
    """InputError that names the pose whose loops can't be closed at its joint values."""
    try:
        return closure.require(lambda row: f"measured pose {measured.pose[row]}")
    except InputError as error:
        raise InputError(f"{error}; check its joint values, their unit and the nominal geometry") from None
