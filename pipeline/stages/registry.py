"""All stages, in the order in which they run.

A stage is a plain function. A parameter annotated with a result (`Model`, `Measured`, ...) is another stage's output;
any other is a setting, the table of robot.toml of that name. Heavy imports happen inside the functions, so that a
cached run loads none of them.
"""

from kincal.pipeline.stages.campaign import filter, measure, plan
from kincal.pipeline.stages.correction import correct, siblings
from kincal.pipeline.stages.drawing import model
from kincal.pipeline.stages.identification import identify
from kincal.pipeline.stages.networks import pretrain, prior, transfer
from kincal.pipeline.stages.page import report
from kincal.pipeline.stages.scoring import compensate, evaluate

# With the libraries whose major.minor version is part of their result.
STAGES = {
    model: ("numpy", "scipy", "pin"),
    plan: ("numpy", "scipy", "casadi", "pandas", "pyarrow"),
    measure: ("numpy", "scipy", "pandas", "pyarrow", "pynmeagps", "rosbags"),
    filter: ("numpy", "filterpy", "pandas", "pyarrow"),
    identify: ("numpy", "scipy", "casadi"),
    prior: ("numpy", "scipy"),
    pretrain: ("numpy", "torch"),
    transfer: ("numpy", "torch"),
    siblings: ("numpy", "torch"),
    correct: ("numpy", "scipy", "casadi"),
    compensate: ("numpy",),
    evaluate: ("numpy", "scipy"),
    report: ("jinja2", "matplotlib"),
}
