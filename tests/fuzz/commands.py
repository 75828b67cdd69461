"""The real command in processes of its own: a sample of spoiled files and of options that nobody means."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from random import Random

from benchmarks.small import QUICK
from kincal.urdf.description import ROBOTS
from tests.fuzz import seeds
from tests.fuzz.case import ROOT, Result
from tests.fuzz.mutations import NUMBERS, TEXTS
from tests.fuzz.targets import spoil

SECONDS = 60.0  # a command may have a stage to run
MEGABYTES = 1500.0
_PROGRESS = re.compile(r"^(\S+ \w+ +(running|ran|cached)\b|note: |warning: )")
NUMBERS_OF = (  # options that want a number
    *("plan ups3_s --poses", "plan ups3_s --accuracy", "plan ups3_s --accuracy-mm", "sweep ups3_s --seeds"),
    *("sea-trial ups3_s --minutes", "sea-trial ups3_s --rate-hz", "sea-trial ups3_s --speed"),
    *("sea-trial ups3_s --delay-ms", "sea-trial ups3_s --bandwidth-hz", "sea-trial ups3_s --seed", "sweep ups3_s --on"),
)  # fmt: skip
TEXTS_OF = (
    *("run", "run ups3_s --until", "run ups3_s --force-from", "inspect", "predict ups3_s --method geometric --joints"),
    *("evaluate ups3_s --data", "compensate ups3_s --method geometric --poses", "init", "run ups3_s --set"),
    *("export ups3_s --format json --method", "export ups3_s --format", "sweep ups3_s --over", "status"),
)  # fmt: skip
SETTINGS_OF = (  # each far too large
    *("plan.poses", "prior.poses", "pretrain.hidden", "siblings.hidden", "correct.shared_units"),
    *("siblings.count", "pretrain.iterations", "identify.max_iterations", "seed", "measure.stream.rate_hz"),
    *("measure.stream.seconds",),
)  # fmt: skip


@dataclass(frozen=True)
class Command:
    """Arguments, and the files in the current folder that they may name."""

    arguments: tuple[str, ...]
    files: seeds.Files


def drawn(random: Random) -> Command:
    kind = random.choice(("number", "text", "setting", "robot", "joints", "poses", "table", "stream"))
    if kind == "number":
        value = random.choice([v for v in NUMBERS if "\0" not in v])
        return Command((*random.choice(NUMBERS_OF).split(), value), {})
    if kind == "text":
        value = random.choice([v for v in (*TEXTS, "seed=" + random.choice(NUMBERS)) if "\0" not in v])
        return Command((*random.choice(TEXTS_OF).split(), value), {})
    if kind == "setting":
        value = random.choice(("1000000000", "1e300", "-1", "10" + "0" * 400, "nan", '"many"', "[1]", "1000001", "1e9"))
        return Command(("run", "ups3_s", "--until", "measure", "--set", f"{random.choice(SETTINGS_OF)}={value}"), {})
    if kind == "robot":
        robot = seeds.robot(ROBOTS / "ups3_s")
        name = random.choice(list(robot))
        return Command(("run", "robot.toml", "--until", "measure"), robot | {name: spoil(name, robot[name], random)})
    frame = seeds.stream() if kind == "stream" else seeds.measured()
    name = random.choice((f"{kind}.csv", f"{kind}.parquet"))
    content = seeds.csv(frame) if name.endswith("csv") else seeds.parquet(frame)
    arguments = {
        "joints": ("predict", "ups3_s", "--method", "geometric", "--joints"),
        "poses": ("compensate", "ups3_s", "--method", "geometric", "--poses"),
        "table": ("evaluate", "ups3_s", "--register", "--data"),
        "stream": ("sea-trial", "ups3_s", "--minutes", "0.1", "--motion"),
    }[kind]
    return Command((*arguments, name), {name: spoil(name, content, random)})


@dataclass
class Kincal:
    """The command, and a store with a finished run, which must stay as it is."""

    root: Path

    def __post_init__(self) -> None:
        self.store = self.root / "store"
        done, _, _ = self._call(("run", "ups3_s"))
        assert done.returncode == 0, done.stderr
        self.stored = self._content()

    def run(self, number: int, command: Command) -> Result:
        """How a command ended: 0, 1 or 2, with one line where it says no; nothing written, nothing lost."""
        shutil.rmtree(self.root / "cwd", ignore_errors=True)
        (self.root / "cwd").mkdir()
        for name, content in command.files.items():
            (self.root / "cwd" / name).write_bytes(content)
        try:
            done, seconds, megabytes = self._call(command.arguments)
        except subprocess.TimeoutExpired:
            return Result("kincal", number, "defect", f"longer than {SECONDS:g} s: {command.arguments}", SECONDS, 0)
        said = [line for line in done.stderr.splitlines() if not _PROGRESS.match(line)]
        wrong = self._wrong(done, said, command, megabytes)
        if wrong:
            said = [f"{wrong}: {command.arguments}: {done.stderr[-300:]}"]
        outcome = "defect" if wrong else "accepted" if done.returncode == 0 else "refused"
        return Result("kincal", number, outcome, "".join(said), seconds, megabytes)

    def _wrong(self, done, said: list[str], command: Command, megabytes: float) -> str | None:
        written = {f.name for f in (self.root / "cwd").iterdir()} - set(command.files)
        now = self._content()
        refused = done.returncode != 0
        checks = {
            f"status {done.returncode}": done.returncode not in (0, 1, 2),
            "a traceback": "Traceback" in done.stderr,
            f"{len(said)} lines": refused and (len(said) != 1 or not said[0].startswith("kincal: ")),
            f"{megabytes:.0f} MB": megabytes > MEGABYTES,
            f"written: {written}": bool(written - {"ups3_s_sea_trial", "ups3_s_compensator", "robot.toml"}),
            "half-written": refused and bool(written),
            "stored results were changed": any(now.get(name) != content for name, content in self.stored.items()),
        }
        return next((what for what, wrong in checks.items() if wrong), None)

    def _content(self) -> dict[str, bytes]:
        return {str(f): f.read_bytes() for f in (self.store / "artifacts").rglob("*") if f.is_file()}

    def _call(self, arguments: tuple[str, ...]):
        folder = self.root / "cwd"
        folder.mkdir(exist_ok=True)
        settings = [part for setting in QUICK for part in ("--set", setting)]
        own = [] if arguments[0] == "init" else [*settings, "--store", str(self.store)]
        # the given arguments come last, and win
        command = [
            sys.executable,
            "-m",
            "tests.fuzz.measured",
            "-m",
            "kincal",
            arguments[0],
            *own,
            *arguments[1:],
        ]
        environment = os.environ | {
            "PYTHONPATH": os.pathsep.join((str(ROOT / "src"), str(ROOT))),
            "PYTHONDONTWRITEBYTECODE": "1",
        }
        began = time.perf_counter()
        done = subprocess.run(
            command, cwd=folder, env=environment, capture_output=True, text=True, errors="replace", timeout=SECONDS
        )
        seconds = time.perf_counter() - began
        *lines, last = done.stderr.splitlines() or [""]
        megabytes = float(last.removeprefix("peak ")) if last.startswith("peak ") else 0.0
        done.stderr = "\n".join(lines)
        return done, seconds, megabytes


def commands(n: int, observe: Callable[[Result], None]) -> list[Result]:
    """The results of n commands, one after another."""
    results = []
    with tempfile.TemporaryDirectory() as folder:
        kincal = Kincal(Path(folder)) if n else None
        for number in range(n if kincal else 0):
            results.append(kincal.run(number, drawn(Random(f"command {number}"))))
            observe(results[-1])
    return results
