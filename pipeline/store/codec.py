"""Values as files, and back: dataclasses as JSON, their tables as Parquet, arrays as safetensors, long texts as text.

Nothing is ever pickled.
"""

from __future__ import annotations

import io
import json
import math
from collections.abc import Mapping
from contextvars import ContextVar
from dataclasses import dataclass, field
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from cattrs import Converter
from pydantic import BaseModel

if TYPE_CHECKING:
    from pandas import DataFrame as Frame
else:

    class Frame:
        """Stands for pandas.DataFrame, whose import takes half a second, until a table is read."""


class Text(str):
    """A text that is stored as a file of its own."""

    file = "text.txt"


@dataclass
class _Codec:
    """The files beside value.json: filled, or read, on one value's way."""

    arrays: dict[str, Any] = field(default_factory=dict)
    files: dict[str, bytes] = field(default_factory=dict)

    def array_out(self, array: Any) -> str:
        name = f"array{len(self.arrays)}"
        self.arrays[name] = array
        return name

    def text_out(self, text: Any) -> str:
        return self._keep(text.file, str(text).encode())

    def table_out(self, table: Any) -> str:
        return self._keep(f"table{len(self.files)}.parquet", table.to_parquet(index=False))

    def table_in(self, name: str) -> Any:
        import pandas as pd

        return pd.read_parquet(io.BytesIO(self.files[name]))

    def _keep(self, name: str, content: bytes) -> str:
        self.files[name] = content
        return name


_CODEC: ContextVar[_Codec] = ContextVar("codec")


@lru_cache(maxsize=1)
def _converter() -> Converter:
    """What it learns about a type takes far longer than a value: one for all."""
    converter, codec = Converter(forbid_extra_keys=True), _CODEC.get
    converter.register_unstructure_hook_func(_is(BaseModel), lambda v: v.model_dump(mode="json", by_alias=True))
    converter.register_structure_hook_func(_is(BaseModel), lambda v, kind: kind.model_validate(v))
    # by class: hooks for strings go before predicates
    converter.register_unstructure_hook(Text, lambda v: codec().text_out(v))
    converter.register_structure_hook(Text, lambda v, kind: kind(codec().files[v].decode()))
    converter.register_unstructure_hook(float, _float_out)
    converter.register_structure_hook(float, lambda v, _: float(v))
    converter.register_unstructure_hook(np.ndarray, lambda v: codec().array_out(v))
    converter.register_structure_hook(np.ndarray, lambda v, _: codec().arrays[v])
    converter.register_unstructure_hook(Frame, lambda v: codec().table_out(v))
    converter.register_structure_hook(Frame, lambda v, _: codec().table_in(v))
    return converter


def _is(base: type):
    return lambda kind: isinstance(kind, type) and issubclass(kind, base)


def _float_out(value: float) -> float | str:
    return value if math.isfinite(value) else repr(value)


def encode(value: Any) -> dict[str, bytes]:
    """A value as files."""
    codec = _Codec()
    _CODEC.set(codec)
    tree = _converter().unstructure(value)
    files = dict(codec.files)
    if codec.arrays:
        from safetensors.numpy import save

        files["arrays.safetensors"] = save({k: np.ascontiguousarray(v) for k, v in codec.arrays.items()})
    files["value.json"] = (json.dumps(tree, indent=1, allow_nan=False) + "\n").encode()
    return files


def decode(files: Mapping[str, bytes], kind: type) -> Any:
    """The value of `kind` that `encode` turned into these files."""
    codec = _Codec(files=dict(files))
    if "arrays.safetensors" in files:
        from safetensors.numpy import load

        codec.arrays = load(files["arrays.safetensors"])
    _CODEC.set(codec)
    return _converter().structure(json.loads(files["value.json"]), kind)
