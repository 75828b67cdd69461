"""CasADi functions as machine code, where so many poses are evaluated that compiling them pays.

The library is kept in the user's cache folder, named by the digest of its C source. Where there is no compiler, or the
folder can't be written, the function stays as it is: interpreted, three to four times as slow.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path

import casadi as ca
from platformdirs import user_cache_path

PAYS = 20_000  # poses: some 50 us saved each, in a handful of iterations, against 3 to 9 s of compiling
_FLAGS = ("-O1", "-shared", "-fPIC")
_SECONDS = 120


def compiled(function: ca.Function, folder: Path | None = None) -> ca.Function:
    """`function` compiled, from the cache where it has been before; `function` itself where that can't be."""
    compiler = find_compiler()
    if not compiler:
        return function
    generator = ca.CodeGenerator("derivatives.c")
    generator.add(function)
    source = generator.dump()
    digest = hashlib.sha256("\n".join((source, compiler, *_FLAGS)).encode()).hexdigest()
    library = (folder or user_cache_path("kincal")) / f"{digest[:32]}.so"
    try:
        if not library.exists():
            _compile(compiler, source, library)
        return ca.external(function.name(), str(library))
    except RuntimeError:  # a library that can't be loaded: the next run makes it anew
        library.unlink(missing_ok=True)
    except (OSError, subprocess.SubprocessError):
        pass
    return function


def find_compiler() -> str | None:
    """The command of a C compiler: that of the environment's CC, or the first usual one on the path."""
    return os.environ.get("CC") or shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")


def build(compiler: str, sources: Sequence[Path], built: Path, *options: str) -> None:
    """Raises OSError or subprocess.SubprocessError where the compiler fails."""
    command = [*compiler.split(), *options, *map(str, sources), "-o", str(built), "-lm"]
    subprocess.run(command, check=True, capture_output=True, timeout=_SECONDS)


def _compile(compiler: str, source: str, library: Path) -> None:
    library.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=library.parent) as folder:
        code, built = Path(folder) / "derivatives.c", Path(folder) / library.name
        code.write_text(source, encoding="utf-8")
        build(compiler, [code], built, *_FLAGS)
        built.replace(library)
