"""The solver of each method."""

from __future__ import annotations

from dataclasses import dataclass, field

from kincal.identification.error_model import BuiltRobot
from kincal.pipeline.compensator.network_solver import NetworkSolver
from kincal.pipeline.compensator.solver import ModelSolver, Solver
from kincal.pipeline.methods.predictors import HybridMethod, Method, ModelMethod, NetworkMethod
from kincal.urdf.description import Workspace

_Key = tuple[int, tuple[str, ...], bool]


@dataclass(frozen=True)
class Solvers:
    """Each is made once."""

    workspace: Workspace
    _made: dict[_Key, tuple[object, ModelSolver]] = field(default_factory=dict, repr=False, compare=False)

    def of(self, method: Method, channels: tuple[str, ...], compiled: bool = False) -> Solver:
        """channels: the parts of desired poses that are known, and so can be met; compiled: for many thousand poses."""
        if isinstance(method, NetworkMethod):
            return NetworkSolver(method, self._of_model(ModelMethod(method.chart.robot), channels, compiled))
        assert isinstance(method, ModelMethod | HybridMethod)
        return self._of_model(method, channels, compiled)

    def _of_model(self, method: ModelMethod | HybridMethod, channels: tuple[str, ...], compiled: bool) -> ModelSolver:
        made_of: BuiltRobot | HybridMethod = method.robot if isinstance(method, ModelMethod) else method
        key = id(made_of), channels, compiled  # kept beside the solver: nothing else gets its id
        if key not in self._made:
            solver = ModelSolver.of(method, channels, self.workspace)
            self._made[key] = made_of, solver.compiled() if compiled else solver
        return self._made[key][1]
