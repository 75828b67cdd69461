"""The README's picture: the 3-UPS/S platform, and its errors before and after calibration.

`python -m benchmarks.picture` runs `kincal run ups3_s` (a virtual robot, default settings) and writes
docs/pictures/ups3_s.svg.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

import kincal
from kincal.pipeline.report.figures import BLUE, GREY, RED, STYLE, clean, svg
from kincal.pipeline.report.numbers import significant
from kincal.urdf.closed_chain import ClosedChain
from kincal.urdf.kinematics import inverse, tree

ROBOT = "ups3_s"
FILE = Path(__file__).parents[1] / "docs" / "pictures" / f"{ROBOT}.svg"
BARS = {  # the methods of the picture
    "nominal": ("as drawn", GREY),
    "transfer": ("transfer network\n(method of the paper)", "#7a3e9d"),
    "geometric": ("identified geometry", BLUE),
    "hybrid": ("geometry and\nlearned correction", RED),
}


def main() -> None:
    with tempfile.TemporaryDirectory() as store:
        calibration = kincal.calibrate(ROBOT, store=store, progress=True)
        errors = calibration.compare()["mean_deg"]
        (model,) = calibration._until("model")
    with rc_context(STYLE):
        figure = Figure(figsize=(8.4, 3.5), layout="constrained")
        left, right = figure.subplots(1, 2, width_ratios=(1, 1.35))
        left.remove()
        _robot(figure.add_subplot(1, 2, 1, projection="3d"), model.chain())
        _bars(right, {name: float(errors[name]) for name in BARS})
        FILE.write_text(svg(figure), encoding="utf-8")
    print(f"{FILE}: mean error {', '.join(f'{n} {significant(float(errors[n]))} deg' for n in BARS)}")


def _bars(axes: Any, errors: dict[str, float]) -> None:
    places = np.arange(len(errors))
    axes.barh(places, list(errors.values()), color=[BARS[name][1] for name in errors], height=0.6)
    axes.set_yticks(places, [BARS[name][0] for name in errors])
    for place, value in zip(places, errors.values(), strict=True):
        axes.text(value * 1.15, place, f"{significant(value)}°", va="center")
    axes.set_xscale("log")
    axes.set_xlim(min(errors.values()) / 2, max(errors.values()) * 4)
    axes.invert_yaxis()
    axes.set_xlabel("mean orientation error at 500 fresh poses [deg]\n(virtual robot, 150 measured poses)")
    clean(axes, "x")


def _robot(axes: Any, chain: ClosedChain) -> None:
    """Legs from base to platform, tilted by 15 degrees."""
    u = np.zeros((1, 6))
    u[0, 3:5] = np.deg2rad([12.0, -9.0])
    q = inverse(chain, u).q
    frames = tree(chain, q)
    anchors, feet = [], []
    for loop in chain.loops:
        ends = [
            frames.point(joint, chain.translation[body])[0]
            for joint, body in zip(loop.joints, loop.bodies, strict=True)
        ]
        foot = frames.translation[chain.path(loop.joints[0])[0]][0]
        feet.append(foot)
        anchors.append(ends[1])
        axes.plot(*np.stack([foot, ends[0]]).T, color=BLUE, lw=3, solid_capstyle="round")
    for points, colour in ((np.array(feet), GREY), (np.array(anchors), RED)):
        ring = np.concatenate([points, points[:1]])
        axes.plot(*ring.T, color=colour, lw=2)
        axes.plot(*points.T, "o", color=colour, ms=5)
        axes.add_collection3d(Poly3DCollection([points], facecolor=colour, alpha=0.2))
    centre = np.mean(anchors, axis=0)
    axes.plot(*np.stack([[0, 0, 0], centre]).T, color=GREY, lw=2, ls=":")
    axes.set_box_aspect((1, 1, 0.9), zoom=1.25)
    axes.set_axis_off()
    axes.view_init(elev=30, azim=20)


if __name__ == "__main__":
    main()
