"""A new kind of measurement is one file and its registration; nothing else changes."""

import json
import os
import subprocess
import sys

HEIGHT = '''"""Height alone: a dial gauge's, along the vertical."""

from kincal.identification.channels.channel import Channel


class _Height(Channel):
    """Values: (n,) [m]."""

    name = "height"
    columns = ("height",)
    column_unit = "m"
    unit = "m"
    rows = 1
    registers = False

    def of(self, pose):
        return pose.translation[:, 2]

    def residual(self, rotation, translation, value):
        return translation[2] - value

    def change(self, by, rotation):
        return by[:, 5:]


HEIGHT = _Height()
'''
REGISTERED = (
    (
        "identification/channels/__init__.py",
        "from kincal.identification.channels.orientation import ORIENTATION\n",
        "from kincal.identification.channels.height import HEIGHT\n"
        "from kincal.identification.channels.orientation import ORIENTATION\n",
    ),
    ("identification/channels/__init__.py", "TILT, YAW)", "TILT, YAW, HEIGHT)"),
    ("urdf/description.py", '    "yaw": ("deg", 0.01),\n', '    "yaw": ("deg", 0.01),\n    "height": ("mm", 0.02),\n'),
)
SETTINGS = {
    "measure.channels": ["tilt", "yaw", "height"],
    "measure.errors.elastic": False,
    "evaluate.closed_loop": False,
    "plan.poses": 60,
    "prior.poses": 60,
    "pretrain.iterations": 2,
    "transfer.iterations": 2,
    "siblings.count": 2,
    "siblings.poses": 40,
    "siblings.iterations": 5,
    "sensor.height_mm": 0.01,
}
SCRIPT = f"""
import json, kincal
robot = kincal.load("gough_stewart", {SETTINGS!r})
data = kincal.measure(robot, seed=1)
fit = kincal.identify(robot, data)
calibration = kincal.calibrate(robot, store="store")
calibration.report("report.html")
compared = calibration.compare()
print(json.dumps({{
    "columns": list(data),
    "channels": fit.identification.channels,
    "sigma": fit.identification.sensor_std["height"],
    "residual": fit.identification.residual_size["height_mm"],
    "predicted": list(calibration.predict(data, method="geometric")),
    "nominal": compared.loc["nominal", "mean_mm"],
    "geometric": compared.loc["geometric", "mean_mm"],
}}))
"""


def test_a_new_channel_is_a_file_and_its_registration(copy_project, tmp_path):
    """Measured by the virtual robot, written, read, identified, predicted, scored and reported."""
    package = copy_project(tmp_path) / "kincal"
    (package / "identification" / "channels" / "height.py").write_text(HEIGHT)
    for name, old, new in REGISTERED:
        text = (package / name).read_text()
        assert text.count(old) == 1
        (package / name).write_text(text.replace(old, new))
    environment = os.environ | {"PYTHONPATH": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert {"roll", "pitch", "yaw", "height"} <= set(found["columns"])
    assert found["channels"] == ["tilt", "yaw", "height"]
    assert abs(found["sigma"] - 1e-5) < 1e-12
    assert 0.001 < found["residual"] < 0.05
    assert {"height", "height_std", "height_95"} <= set(found["predicted"])
    assert found["geometric"] < 0.3 * found["nominal"]
    assert "; height 0.0" in (tmp_path / "report.html").read_text()
