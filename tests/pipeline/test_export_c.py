"""`kincal export --format c`: what is written, what is refused, and what a failure leaves behind."""

import re
import shutil
import subprocess

import numpy as np
import pytest

from kincal.identification.compiled import find_compiler
from kincal.identification.measurements import quaternions
from kincal.pipeline.export import c_code as exported_c
from kincal.pipeline.export import formats
from kincal.pipeline.export.c_code import export as export_code
from kincal.pipeline.run.calibrated import calibrated
from kincal.urdf.errors import CalibrationError, InputError

NAMES = {"kincal_ups3_s.c", "kincal_ups3_s.h", "kincal_ups3_s_main.c"}


@pytest.fixture(scope="module")
def session(start, finished, tmp_path_factory):
    """A copy of the finished run: others count its artifacts."""
    store = shutil.copytree(finished.store, tmp_path_factory.mktemp("exported_c") / "store")
    return start(store, "plan.poses=12")[0]


def test_three_files_that_say_where_they_come_from(session, tmp_path):
    exported = export_code(session, tmp_path / "code", method="hybrid")
    assert {f.name for f in (tmp_path / "code").iterdir()} == NAMES
    assert [f.name for f in tmp_path.iterdir()] == ["code"]
    assert exported.agreement.command < 1e-9
    assert exported.agreement.n_checked > 200
    header = (tmp_path / "code" / "kincal_ups3_s.h").read_text()
    assert header.startswith("/* kincal export: ups3_s, compensator of the hybrid method, identified from 12 poses")
    assert session.entries["identify"].digest in header
    assert "What counts: orientation. It is met on the tool's axes rx, ry, rz" in header


def test_a_controllers_own_build(session, tmp_path):
    """C99, warnings are errors; what comes out are the method's commands."""
    if find_compiler() is None:
        pytest.skip("there is no C compiler here")
    export_code(session, tmp_path / "code", method="geometric")
    files = [str(tmp_path / "code" / f"kincal_ups3_s{end}.c") for end in ("", "_main")]
    strict = ["-std=c99", "-pedantic", "-Wall", "-Werror", "-O1"]
    subprocess.run(["cc", *strict, *files, "-lm", "-o", str(tmp_path / "program")], check=True, timeout=60)
    found = calibrated(session.robot.description, session.until, "geometric")
    method = found.methods["geometric"]
    readings = session.until("filter")[0].table[list(found.model.chain.actuated_names)].to_numpy(float)
    desired = method.predict(readings)
    rows = np.column_stack([desired.translation, quaternions(desired.rotation)])
    text = "\n".join(" ".join(map(repr, map(float, row))) for row in rows)
    said = subprocess.run([tmp_path / "program"], input=text, capture_output=True, text=True, check=True, timeout=10)
    printed = np.array([line.split() for line in said.stdout.splitlines()[1:]], dtype=float)
    np.testing.assert_allclose(printed[:, :3], readings, rtol=0, atol=1e-9)


def test_where_it_may_write(session, tmp_path):
    """A folder of its own is replaced, another one only with --force, and then the rest of it stays."""
    folder = tmp_path / "code"
    export_code(session, folder, method="geometric")
    export_code(session, folder, method="hybrid")
    assert "hybrid" in (folder / "kincal_ups3_s.h").read_text()
    other = tmp_path / "other"
    other.mkdir()
    (other / "mine.c").write_text("int mine;")
    with pytest.raises(InputError, match="was not made by kincal export"):
        export_code(session, other, method="geometric")
    assert [f.name for f in other.iterdir()] == ["mine.c"]
    export_code(session, other, method="geometric", force=True)
    assert {f.name for f in other.iterdir()} == NAMES | {"mine.c"}
    with pytest.raises(InputError, match="allowed is another one"):
        export_code(session, session.robot.file.parent, method="geometric")
    with pytest.raises(InputError, match=r"--method transfer: --format c has code for geometric and hybrid"):
        formats.export(session, "c", tmp_path / "more", False, "transfer")


def test_code_that_says_something_else_is_not_handed_out(session, tmp_path, monkeypatch):
    monkeypatch.setattr(exported_c, "TOLERANCE", 1e-20)
    with pytest.raises(CalibrationError, match=r"the code's commands differ by .*nothing was exported"):
        export_code(session, tmp_path / "code", method="geometric")
    assert not list(tmp_path.iterdir())


def test_code_that_the_compiler_refuses_is_not_handed_out(session, tmp_path, monkeypatch):
    if find_compiler() is None:
        pytest.skip("there is no C compiler here")
    whole = exported_c.sources
    spoiled = lambda *a: {name: text + "\nsyntax error\n" for name, text in whole(*a).items()}  # noqa: E731
    monkeypatch.setattr(exported_c, "sources", spoiled)
    with pytest.raises(CalibrationError, match=r"refuses the code .*nothing was exported"):
        export_code(session, tmp_path / "code", method="geometric")
    assert not list(tmp_path.iterdir())


def test_the_command(cli, store, finished, monkeypatch, tmp_path):
    """Its default folder; without a compiler it says so."""
    overrides = [part for setting in finished.settings for part in ("--set", setting)]
    answer = cli("export", "ups3_s", "--format", "c", "--store", store, *overrides)
    assert answer.status == 0, answer.err
    assert re.search(r"ups3_s_compensator: commands as kincal compensate does, within \S+ m or rad", answer.out)
    assert {f.name for f in (tmp_path / "ups3_s_compensator").iterdir()} == NAMES
    monkeypatch.setattr(exported_c, "find_compiler", lambda: None)
    answer = cli("export", "ups3_s", "--format", "c", "--method", "geometric", "--store", store, *overrides)
    assert answer.status == 0, answer.err
    assert "not compiled" in answer.err
    answer = cli("export", "ups3_s", "--format", "json", "--method", "hybrid", "--store", store, *overrides)
    assert answer.status == 2
    assert "--method hybrid: --format json has none" in answer.err
