"""Names that columns of a measurement table have elsewhere: `Position X [mm]`, `tx`, `Leg 1 slide (deg)`."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable, Mapping, Sequence

from kincal.urdf.description import Column

_UNITS = {
    "m": "m",
    "mm": "mm",
    "cm": "cm",
    "in": "in",
    "inch": "in",
    "rad": "rad",
    "deg": "deg",
    "°": "deg",
    "rev": "rev",
}
_UNIT = re.compile(rf"(?:\s*[\[(]\s*({'|'.join(_UNITS)})\s*[\])]|[\s_](mm|cm|deg|rad))\s*$", re.IGNORECASE)
_POSITION = ("pos{}", "position{}", "p{}", "t{}", "{}pos", "translation{}", "meas{}", "measured{}")
_QUATERNION = ("quat{}", "quaternion{}", "orientation{}", "rotation{}", "q{}")
_OTHERS = {"heading": "yaw", "posenumber": "pose", "poseno": "pose", "posenr": "pose"}


def proposals(columns: Sequence[str], wanted: Iterable[str]) -> dict[str, Column]:
    """{canonical name: the column that likely has it, and its unit}; where two columns fit a name, neither does."""
    wanted = list(wanted)
    meant = _synonyms(wanted)
    by_name: dict[str, list[Column]] = {}
    for column in columns:
        base, unit = _parted(column)
        if base in meant:
            by_name.setdefault(meant[base], []).append(Column.model_validate({"from": column, "unit": unit}))
    return {name: fitting[0] for name, fitting in by_name.items() if len(fitting) == 1}


def _synonyms(wanted: Sequence[str]) -> Mapping[str, str]:
    """{a name without blanks, signs and capitals: the canonical one}"""
    names = {pattern.format(axis): axis for axis in "xyz" for pattern in _POSITION}
    names |= {pattern.format(axis): f"q{axis}" for axis in "xyzw" for pattern in _QUATERNION}
    names = {**names, **_OTHERS}
    return {name: canonical for name, canonical in names.items() if canonical in wanted} | {_base(n): n for n in wanted}


def _parted(column: str) -> tuple[str, str]:
    """A column's name without its unit, and the unit; 1 where it has none."""
    text = unicodedata.normalize("NFKC", column).strip()
    match = _UNIT.search(text)
    if match is None or match.start() == 0:
        return _base(text), "1"
    return _base(text[: match.start()]), _UNITS[(match[1] or match[2]).lower()]


def _base(name: str) -> str:
    return re.sub(r"[\W_]+", "", name.casefold())
