"""An installation holds one package, `kincal`, and works beside a user's modules of any other name.

These tests install without dependencies, beside the packages that are there. `make package` installs those too.
"""

from __future__ import annotations

import json
import re
import sys
from dataclasses import dataclass
from pathlib import Path
from zipfile import ZipFile

import pytest

from kincal.version import __version__
from tests.package.distributions import build, copy_of_checkout, hostile_folder, output, unpacked
from tests.sources import ROOT

PACKAGES = "packages_of_the_tests.pth"


def _names(wheel: Path) -> set[str]:
    with ZipFile(wheel) as archive:
        return {name for name in archive.namelist() if not name.endswith("/")}


def _package(source: Path) -> set[str]:
    """The files below src/kincal, those behind links included."""
    found, folders = set(), [source / "src" / "kincal"]
    while folders:
        for path in folders.pop().iterdir():
            if path.is_dir():
                folders.append(path)
            else:
                found.add(path.relative_to(source / "src").as_posix())
    return found


@dataclass(frozen=True)
class Environment:
    """A virtual environment with the wheel installed."""

    folder: Path

    @property
    def python(self) -> Path:
        return self.folder / "bin" / "python"

    @property
    def kincal(self) -> Path:
        return self.folder / "bin" / "kincal"

    @property
    def site(self) -> Path:
        (site,) = self.folder.glob("lib/python*/site-packages")
        return site


@pytest.fixture(scope="session")
def checkout(tmp_path_factory) -> Path:
    return copy_of_checkout(tmp_path_factory.mktemp("checkout"))


@pytest.fixture(scope="session")
def files(checkout) -> set[str]:
    """The package's files as the checkout has them, listed before a build adds any."""
    return _package(checkout)


@pytest.fixture(scope="session")
def sdist(checkout, files, tmp_path_factory) -> Path:
    return build("sdist", checkout, tmp_path_factory.mktemp("sdist"))


@pytest.fixture(scope="session")
def wheel(checkout, files, tmp_path_factory) -> Path:
    return build("wheel", checkout, tmp_path_factory.mktemp("wheel"))


@pytest.fixture(scope="session")
def environment(wheel, tmp_path_factory) -> Environment:
    """The wheel in an environment of its own, which also sees the packages of this one, but not this one's kincal."""
    made = Environment(tmp_path_factory.mktemp("environment"))
    output(sys.executable, "-m", "venv", "--without-pip", made.folder, cwd=made.folder)
    install = (sys.executable, "-m", "pip", "--python", made.python, "install", "--no-deps", "--no-index", "--quiet")
    output(*install, wheel, cwd=made.folder)
    # Paths in a .pth file are appended as they are: the .pth files in those folders, an editable kincal's too, are not
    # read. So every folder of packages is listed, also those that such a file added here.
    packages = [path for path in sys.path if Path(path).name in ("site-packages", "dist-packages")]
    (made.site / PACKAGES).write_text("\n".join(packages))
    return made


@pytest.fixture
def hostile(tmp_path) -> Path:
    return hostile_folder(tmp_path / "a user's folder")


def test_a_wheel_holds_the_package_and_nothing_else(wheel, files):
    names = _names(wheel)
    assert {name.split("/")[0] for name in names} == {"kincal", f"kincal-{__version__}.dist-info"}
    assert {name for name in names if name.startswith("kincal/")} == files


@pytest.mark.parametrize(
    "pattern",
    [
        r"kincal/py\.typed",
        r"kincal/__init__\.pyi",
        r"kincal/urdf/robots/ups3_s/robot\.urdf",
        r"kincal/urdf/robots/ups3_s/robot\.toml",
        r"kincal/pipeline/(\w+/)*templates/\w+\.html",
        r"kincal/pipeline/(\w+/)*templates/\w+\.[ch]",
    ],
)
def test_a_wheel_holds_what_is_no_module(wheel, pattern):
    assert any(re.fullmatch(pattern, name) for name in _names(wheel))


def test_an_sdist_holds_the_package_without_links(sdist, files, tmp_path):
    source = unpacked(sdist, tmp_path)
    assert source.name == f"kincal-{__version__}"
    assert _package(source) == files
    assert not any(path.is_symlink() for path in source.rglob("*"))


def test_the_wheel_of_an_sdist_is_the_wheel_of_the_checkout(sdist, wheel, tmp_path):
    second = build("wheel", unpacked(sdist, tmp_path / "source"), tmp_path / "wheel")
    assert second.name == wheel.name
    with ZipFile(wheel) as a, ZipFile(second) as b:
        differ = [name for name in a.namelist() if name not in b.namelist() or a.read(name) != b.read(name)]
        assert sorted(a.namelist()) == sorted(b.namelist())
    assert not differ


def test_an_installation_has_one_top_level_name(environment):
    (record,) = environment.site.glob("kincal-*.dist-info/RECORD")
    tops = {line.split(",")[0].split("/")[0] for line in record.read_text().splitlines()}
    assert tops == {"kincal", f"kincal-{__version__}.dist-info", ".."}  # .. is bin/kincal
    assert {path.name for path in environment.site.iterdir()} == tops - {".."} | {PACKAGES}


def test_python_imports_the_installed_package(environment, hostile):
    file = output(environment.python, "-c", "import kincal; print(kincal.__file__)", cwd=hostile).strip()
    assert Path(file) == environment.site / "kincal" / "__init__.py"


@pytest.mark.parametrize("variables", [{}, {"PYTHONPATH": "."}], ids=["alone", "PYTHONPATH=."])
def test_the_command_works_beside_modules_of_the_old_names(environment, hostile, variables):
    assert output(environment.kincal, "--version", cwd=hostile, **variables).strip() == __version__
    assert output(environment.python, "-m", "kincal", "--version", cwd=hostile, **variables).strip() == __version__
    printed = output(environment.kincal, "run", "ups3_s", "--until", "model", "--json", cwd=hostile, **variables)
    document = json.loads(printed)
    assert document["stage"] == "model"
    assert document["provenance"]["versions"]["kincal"] == __version__


def test_worker_processes_work_beside_modules_of_the_old_names(environment, hostile):
    robots = ("ups3_s", "rps3")
    printed = output(environment.kincal, "run", *robots, "--until", "model", "--on", "2", cwd=hostile, PYTHONPATH=".")
    assert all(robot in printed for robot in robots)


QUICK = """{"plan.poses": 24, "prior.poses": 64, "pretrain.iterations": 5, "transfer.iterations": 5,
    "siblings.count": 2, "siblings.poses": 40, "siblings.iterations": 20}"""
MORE = """
table = kincal.sweep(robot, over={"plan.poses": [16, 24]}, seeds=2, workers=2, store=".kincal").medians
assert len(table) == 12
assert len(kincal.plan(robot, poses=20, layout="grid")) == 20
assert set(calibration.compare().index) == {
    "nominal", "geometric", "network", "transfer", "transfer_identified", "hybrid"
}
assert calibration.predict(data)["share"].between(0, 1).all()
assert calibration.evaluate(kincal.measure(robot, seed=1), register=True).loc["geometric", "mean_deg"] < 0.1
try:
    kincal.identify(robot, data.drop(columns="leg1_slide"))
except kincal.InputError as error:
    assert "leg1_slide" in str(error)
else:
    raise AssertionError("a table without a joint was taken")
"""


def test_the_example_of_the_docs_runs(environment, hostile):
    """The lines that a user types in a notebook, beside modules of the old names; on small settings."""
    text = (ROOT / "docs" / "how-to" / "python.md").read_text()
    example = re.search(r"```python\n(.*?)```", text, re.DOTALL)[1]
    assert '{"plan.poses": 60}' in example
    script = hostile / "notebook.py"
    script.write_text(example.replace('{"plan.poses": 60}', QUICK) + MORE)
    printed = output(environment.python, script, cwd=hostile, PYTHONPATH=".")
    assert "hybrid" in printed
    assert (hostile / "calibrated" / "robot.urdf").is_file()
    assert "</html>" in (hostile / "report.html").read_text()
