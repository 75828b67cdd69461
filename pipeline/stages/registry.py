"""All stages, in the order in which they run.

A stage is a plain function. A parameter annotated with a result (`Model`, `Measured`, ...) is another stage's output;
any other is a setting, the table of robot.toml of that name. Heavy imports happen inside the functions, so that a
cached run loads none of them.
"""

from collections.abc import Callable
from typing import Any

from kincal.pipeline.stages.campaign import filter_stage, measure_stage, plan_stage
from kincal.pipeline.stages.correction import correct_stage, siblings_stage
from kincal.pipeline.stages.drawing import model_stage
from kincal.pipeline.stages.identification import identify_stage
from kincal.pipeline.stages.networks import pretrain_stage, prior_stage, transfer_stage
from kincal.pipeline.stages.page import report_stage
from kincal.pipeline.stages.scoring import compensate_stage, evaluate_stage

# {name: the function, and the libraries whose major.minor version is part of its result}
STAGES: dict[str, tuple[Callable[..., Any], tuple[str, ...]]] = {
    "model": (model_stage, ("numpy", "scipy", "pin")),
    "plan": (plan_stage, ("numpy", "scipy", "casadi", "pandas", "pyarrow")),
    "measure": (measure_stage, ("numpy", "scipy", "pandas", "pyarrow", "pynmeagps", "rosbags")),
    "filter": (filter_stage, ("numpy", "filterpy", "pandas", "pyarrow")),
    "identify": (identify_stage, ("numpy", "scipy", "casadi")),
    "prior": (prior_stage, ("numpy", "scipy")),
    "pretrain": (pretrain_stage, ("numpy", "torch")),
    "transfer": (transfer_stage, ("numpy", "torch")),
    "siblings": (siblings_stage, ("numpy", "torch")),
    "correct": (correct_stage, ("numpy", "scipy", "casadi")),
    "compensate": (compensate_stage, ("numpy", "scipy", "casadi")),
    "evaluate": (evaluate_stage, ("numpy", "scipy")),
    "report": (report_stage, ("jinja2", "matplotlib")),
}
