"""`--over key=VALUES`: which values a sweep goes through, and every combination of them."""

from __future__ import annotations

import json
import tomllib
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from itertools import product
from math import prod
from typing import Any

from kincal.urdf.errors import InputError, quoted
from kincal.urdf.input_files import parse_toml
from kincal.urdf.toml_values import as_toml

MOST_JOBS = 10_000
_LARGEST = 15  # power of ten of a number in a progression
_INTEGERS = 2**63
_OPEN, _CLOSE, _QUOTES = "[{", "]}", "\"'"


@dataclass(frozen=True)
class Over:
    """A key of robot.toml and the values that it takes, as they were written in TOML."""

    key: str
    texts: tuple[str, ...]

    def overrides(self) -> tuple[str, ...]:
        return tuple(f"{self.key}={text}" for text in self.texts)

    @property
    def values(self) -> tuple[Any, ...]:
        return tuple(toml_value(text) for text in self.texts)

    @property
    def numeric(self) -> bool:
        return all(isinstance(v, int | float) and not isinstance(v, bool) for v in self.values)


def parse_over(text: str) -> Over:
    """`key=a,b,c` or `key=first,second,...,last`. Raises InputError."""
    key, equals, listed = text.partition("=")
    key = ".".join(part.strip() for part in key.split("."))
    if not equals or not key:
        raise InputError(f"--over {text}: allowed is table.key=value,value,...")
    texts: list[str] = []
    items = _split(listed, text)
    k = 0
    while k < len(items):
        if items[k] == "...":
            texts += _progression(texts, items[k + 1 : k + 2], text)
            k += 2
        else:
            texts.append(items[k])
            k += 1
    if "" in texts:
        raise InputError(f"--over {text}: a value is missing")
    repeated = next((item for item, n in Counter(texts).items() if n > 1), None)
    if repeated is not None:
        raise InputError(f"--over {text}: {repeated} appears twice")
    for item in texts:
        toml_value(item)
    return Over(key, tuple(texts))


def over_of(key: str, values: Sequence[Any]) -> Over:
    """A key and its values, as Python has them. Raises InputError."""
    if isinstance(values, str) or not isinstance(values, Iterable) or not (listed := list(values)):
        raise InputError(f"over {key}: found {quoted(values)}; allowed is a list of values, [20, 50]")
    texts = tuple(as_toml(value, f"over {key}") for value in listed)
    repeated = next((text for text, n in Counter(texts).items() if n > 1), None)
    if repeated is not None:
        raise InputError(f"over {key}: {repeated} appears twice")
    return Over(key, texts)


def combinations(overs: Sequence[Over]) -> list[tuple[int, ...]]:
    """Every combination of the keys' values, as places in them; the last key changes fastest. Raises InputError."""
    keys = [over.key for over in overs]
    repeated = next((key for key in keys if keys.count(key) > 1), None)
    if repeated is not None:
        more = " (--seeds sets it, too)" if repeated == "seed" else ""
        raise InputError(f"--over {repeated}: swept twice{more}")
    n = prod(len(over.texts) for over in overs)
    if n > MOST_JOBS:
        raise InputError(f"sweep of {n} jobs: allowed are {MOST_JOBS}")
    return list(product(*(range(len(over.texts)) for over in overs)))


def toml_value(text: str) -> Any:
    """A value in TOML syntax; a bare word is a string, and so is what neither JSON nor a table of numbers can hold.

    Raises InputError where nothing can read it.
    """
    try:
        value = parse_toml(f"value = {text}")["value"]
        json.dumps(value, allow_nan=False)
    except (tomllib.TOMLDecodeError, TypeError):
        return text
    except ValueError as error:
        if "JSON" in str(error):  # inf, nan
            return text
        raise InputError(f"--over {text[:20]}...: {error}") from None  # too many digits, or nested too deeply
    return text if isinstance(value, int) and abs(value) >= _INTEGERS else value


def _split(listed: str, text: str) -> list[str]:
    """At the commas outside of brackets and quotes."""
    items, depth, quote, begin = [], 0, "", 0
    for k, letter in enumerate(listed):
        if quote:
            quote = "" if letter == quote else quote
        elif letter in _QUOTES:
            quote = letter
        elif letter in _OPEN:
            depth += 1
        elif letter in _CLOSE:
            depth -= 1
        elif letter == "," and depth == 0:
            items.append(listed[begin:k].strip())
            begin = k + 1
    if depth or quote:
        raise InputError(f"--over {text}: a bracket or a quote is not closed")
    return [*items, listed[begin:].strip()]


def _progression(before: Sequence[str], last: Sequence[str], text: str) -> list[str]:
    """What `...` stands for, and the last value: exact in decimals."""
    if len(before) < 2 or not last:
        raise InputError(f"--over {text}: `...` belongs between two values and the last one: first,second,...,last")
    first, second, end = (_number(item, text) for item in (*before[-2:], *last))
    step = second - first
    n = (end - second) / step if step else Decimal(0)
    if n > MOST_JOBS:
        raise InputError(f"--over {text}: {n:.0f} values; allowed are {MOST_JOBS}")
    if n < 1 or n != int(n):
        raise InputError(f"--over {text}: no steps of {step} lead from {before[-1]} to {last[0]}")
    return [str(second + k * step) for k in range(1, int(n))] + [last[0]]


def _number(item: str, text: str) -> Decimal:
    try:
        number = Decimal(item)
    except InvalidOperation:
        number = Decimal("nan")
    if not number.is_finite() or (number and not -_LARGEST < number.adjusted() < _LARGEST):
        raise InputError(f"--over {text}: `...` counts in numbers; found {item or 'nothing'}")
    return number
