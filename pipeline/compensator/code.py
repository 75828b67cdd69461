"""A compensator as C99: what CasADi generates for its steps, and Newton's method around it from templates."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Sequence
from pathlib import Path

import casadi as ca
import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined

from kincal.identification.channels import all_turns
from kincal.pipeline.compensator.compensator import SLACK, Compensator
from kincal.pipeline.compensator.solver import LONGEST, ROUGH, SETTLED, SURE
from kincal.pipeline.methods.predictors import HybridMethod
from kincal.urdf.workspace import AXES

_LONG = 110  # letters of a comment's line
_NO_LIMIT = 1e308


def code_name(robot: str) -> str:
    """What the names of all that is generated for a robot begin with."""
    return "kincal_" + re.sub(r"[^A-Za-z0-9]", "_", robot)


def sources(compensator: Compensator, name: str, remarks: Sequence[str]) -> dict[str, str]:
    """{file name: text} of the code, its header and a test program; remarks: where it comes from, in lines."""
    solver = compensator.solver
    robot, method, steps = solver.robot, solver.method, solver.steps
    chain = robot.chain
    values = {
        "name": name,
        "NAME": name.upper(),
        "said": [line for text in remarks for line in _comment(text)],
        "poses": [line for text in _what_counts(compensator) for line in _comment(text)],
        "hybrid": steps.hybrid is not None,
        "generated": _generated(steps.all(), name),
        "actuators": len(chain.actuated),
        "joints": chain.n_joints,
        "passive": len(chain.passive),
        "axes": len(chain.tool_axes),
        "names": [quoted(n) for n in chain.actuated_names],
        "actuated": chain.actuated.tolist(),
        "passive_joints": chain.passive.tolist(),
        "gain": _numbers(robot.actuators.gain),
        "zero": _numbers(robot.actuators.zero),
        "home": _numbers(solver.home),
        "apart": _numbers(solver.apart),
        "lower": _numbers(np.maximum(chain.lower, -_NO_LIMIT)),
        "upper": _numbers(np.minimum(chain.upper, _NO_LIMIT)),
        "workspace": [f"{{{', '.join(_numbers(ends))}}}" for ends in compensator.workspace],
        "signs": compensator.signs,
        "most": compensator.most,
        "settled": SETTLED,
        "sure": SURE,
        "rough": ROUGH,
        "slack": SLACK,
        "longest": LONGEST,
    }
    if isinstance(method, HybridMethod):
        refined = method.refined.actuators
        values |= {"refined_gain": _numbers(refined.gain), "refined_zero": _numbers(refined.zero)}
    loader = FileSystemLoader(Path(__file__).parent / "templates")
    environment = Environment(loader=loader, undefined=StrictUndefined, trim_blocks=True, keep_trailing_newline=True)
    files = {".h": "compensator.h", ".c": "compensator.c", "_main.c": "compensator_main.c"}
    return {name + end: environment.get_template(file).render(values) for end, file in files.items()}


def quoted(text: str) -> str:
    """A C string literal of any text: what is not plain ASCII is written in octal, and so are question marks, which
    begin trigraphs."""
    plain = set(range(32, 127)) - set(b'"\\?')
    return '"' + "".join(chr(b) if b in plain else f"\\{b:03o}" for b in text.encode()) + '"'


def _comment(text: str) -> list[str]:
    """Lines that can't end a comment, whatever the text holds."""
    plain = "".join(c if c.isprintable() else " " for c in text).replace("*/", "* /").replace("/*", "/ *")
    return textwrap.wrap(plain.replace("??", "? ?"), _LONG)


def _what_counts(compensator: Compensator) -> list[str]:
    """Which parts of a desired pose are looked at."""
    goal = compensator.solver.goal
    axes, turns, moves = goal.robot.chain.tool_axes, all_turns(goal.asked), "position" in goal.asked
    heading = {"tilt": "tilt alone, whatever the heading", "yaw": "heading alone"}
    orientation = "orientation" if turns else next((heading[c] for c in heading if c in goal.asked), "")
    counts = " and ".join([orientation] * bool(orientation) + ["position"] * moves)
    return [
        f"What counts: {counts}. It is met on the tool's axes {', '.join(AXES[a] for a in axes)}"
        f"{'' if len(axes) == 6 else '; what the tool can not choose, the mechanism decides'}."
    ]


def _generated(functions: Sequence[ca.Function], name: str) -> str:
    generator = ca.CodeGenerator(f"{name}.c", {"casadi_int": "int"})
    for function in functions:
        inputs = function.sx_in()
        outputs = function.call(inputs)
        generator.add(ca.Function(f"{name}_{function.name()}", inputs, outputs))
    return generator.dump()


def _numbers(values: np.ndarray) -> list[str]:
    return [repr(float(v)) for v in values]
