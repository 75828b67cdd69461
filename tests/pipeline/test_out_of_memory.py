"""Where memory runs out: one line, status 1, and what was computed stays."""

import pytest

from kincal.pipeline.run import runner
from kincal.pipeline.run.memory import within_memory
from kincal.pipeline.run.stage import Stage
from kincal.pipeline.store import store as of_store
from kincal.urdf.errors import CalibrationError

TEXT = "out of memory; finished results stay in the store"
TORCH = RuntimeError("[enforce fail at alloc_cpu.cpp:114] DefaultCPUAllocator: can't allocate memory: you tried")


def one_line(answer) -> None:
    assert answer.status == 1
    assert TEXT in answer.err.splitlines()[-1]
    assert "Traceback" not in answer.err


@pytest.mark.parametrize(
    "error", [MemoryError(), TORCH, RuntimeError("std::bad_alloc")], ids=["python", "torch", "C++"]
)
def test_a_stage(cli, monkeypatch, tmp_path, error):
    call, store = Stage.call, tmp_path / "store"

    def fails(self, values):
        if self.name == "plan":
            raise error
        return call(self, values)

    monkeypatch.setattr(Stage, "call", fails)
    answer = cli("run", "ups3_s", "--until", "plan", "--store", store)
    one_line(answer)
    assert answer.err.splitlines()[-1].startswith("kincal: plan: out of memory")
    assert cli("status", "ups3_s", "--store", store).out.splitlines()[1].split()[:2] == ["model", "fresh"]


def test_other_errors_are_none_of_memory():
    for error in (RuntimeError("std::logic_error"), CalibrationError("can't allocate memory")):
        with pytest.raises(type(error), match=str(error)), within_memory("plan"):
            raise error


def test_beside_the_stages(cli, monkeypatch, tmp_path):
    def fails(*arguments):
        raise MemoryError

    monkeypatch.setattr(runner.Run, "status", fails)
    one_line(cli("status", "ups3_s", "--store", tmp_path / "store"))


def test_an_artifact_that_does_not_fit_into_memory_is_not_damaged(cli, monkeypatch, tmp_path):
    store = tmp_path / "store"
    assert cli("run", "ups3_s", "--until", "model", "--store", store).status == 0

    def fails(*arguments):
        raise MemoryError

    with monkeypatch.context() as patched:
        patched.setattr(of_store, "decode", fails)
        one_line(cli("run", "ups3_s", "--until", "model", "--store", store))
    assert not (store / "damaged").exists()
    assert "cached" in cli("run", "ups3_s", "--until", "model", "--store", store).err
