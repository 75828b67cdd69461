"""Ways to spoil a file that leave it well-formed: keys, elements, columns, types."""

from __future__ import annotations

import copy
import csv
import io
import json
import sqlite3
import tomllib
import xml.etree.ElementTree as Xml
from datetime import UTC, date, datetime
from functools import reduce
from random import Random
from typing import Any

from tests.fuzz.mutations import NUMBERS, TEXTS

VALUES: tuple[Any, ...] = (
    *(None, True, False, 0, -1, 1, 2**31, 2**63, 2**64, -(2**70), 10**400, 1 << 20_000, 1.5, -0.0, 1e308, 5e-324),
    *(float("nan"), float("inf"), "", "nan", [], [[]], [1], [1, 2, 3], ["a", 1], {}, {"a": {}}, {"from": "x"}, [{}]),
    *(date(2020, 1, 1), datetime(2020, 1, 1, tzinfo=UTC), [[[[[1]]]]], [0.0] * 1000),
)


def _containers(value: Any) -> list[Any]:
    parts = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    own = [value] if isinstance(value, dict | list) else []
    return own + [inner for part in parts for inner in _containers(part)]


def _name(old: str, random: Random) -> str:
    return random.choice((old[:-1], old + "s", old.upper(), old + old, *random.sample(TEXTS, 3), "x" * 1000))


def edit(tree: Any, random: Random) -> None:
    """One change of a tree of dictionaries and lists, in place."""
    filled = [c for c in _containers(tree) if c]
    if not filled:
        return
    place = random.choice(filled)
    key = random.choice(list(place)) if isinstance(place, dict) else random.randrange(len(place))
    action = random.choice(("drop", "rename", "again", "value", "value", "value", "text", "nest", "swap"))
    if action == "drop":
        del place[key]
    elif action == "value":
        place[key] = copy.deepcopy(random.choice(VALUES))
    elif action == "text":
        place[key] = random.choice((*TEXTS, *NUMBERS))
    elif action == "nest":
        for _ in range(random.choice((1, 2, 50))):
            place[key] = random.choice(([place[key]], {"a": place[key]}))
    elif action == "swap":
        other = random.choice(filled)
        there = random.choice(list(other)) if isinstance(other, dict) else random.randrange(len(other))
        place[key], other[there] = copy.deepcopy(other[there]), copy.deepcopy(place[key])
    elif isinstance(place, list):
        place.extend(copy.deepcopy(place[key]) for _ in range(random.choice((1, 2, 600))))
    else:
        place[_name(str(key), random)] = copy.deepcopy(place[key]) if action == "again" else place.pop(key)


def toml(content: bytes, random: Random) -> bytes:
    import tomlkit

    tree = tomllib.loads(content.decode())
    for _ in range(random.choice((1, 1, 2, 3))):
        edit(tree, random)
    return tomlkit.dumps(tree).encode()


def json_(content: bytes, random: Random) -> bytes:
    tree = json.loads(content)
    for _ in range(random.choice((1, 1, 2, 3))):
        edit(tree, random)
    return json.dumps(tree, default=str).encode()


def xml(content: bytes, random: Random) -> bytes:
    root = Xml.fromstring(content.decode())
    for _ in range(random.choice((1, 1, 2, 3))):
        _edit_xml(root, random)
    text = Xml.tostring(root, encoding="unicode")
    if random.random() < 0.1:
        text = random.choice(_PROLOGUES) + text
    return text.encode()


_PROLOGUES = (
    '<?xml version="1.1"?>',
    '<?xml version="1.0" encoding="utf-16"?>',
    '<?xml version="1.0" encoding="nonsense"?>',
    "<!DOCTYPE robot>",
    '<!DOCTYPE r [<!ENTITY a "' + "ha" * 5000 + '">]>',
    '<!DOCTYPE r SYSTEM "file:///dev/zero">',
    '<!DOCTYPE r [<!ENTITY % p SYSTEM "file:///etc/passwd"> %p;]>',
    '<?xml-stylesheet href="file:///dev/zero"?>',
    "<!-- " + "- " * 5000 + "-->",
)


def _edit_xml(root: Xml.Element, random: Random) -> None:
    elements = list(root.iter())
    element = random.choice(elements)
    parents = [e for e in elements if len(e)]
    parent = random.choice(parents) if parents else root
    action = random.choice(
        ("drop", "again", "move", "tag", "attribute", "attribute", "attribute", "text", "deep", "key")
    )
    if action == "drop" and len(parent):
        parent.remove(random.choice(list(parent)))
    elif action == "again" and len(parent):
        one = random.choice(list(parent))
        parent.extend(copy.deepcopy(one) for _ in range(random.choice((1, 2, 50, 600))))
    elif action == "move" and len(parent):
        random.choice(elements).append(copy.deepcopy(random.choice(list(parent))))
    elif action == "tag":
        element.tag = random.choice([e.tag for e in elements] + ["geom", "default", "frame", "mesh", "include", "x"])
    elif action == "text":
        element.text = _clean(random.choice((*TEXTS, *NUMBERS)))
    elif action == "deep":
        for _ in range(random.choice((10, 600, 5000))):
            element = Xml.SubElement(element, random.choice((root.tag, "body", "default", "link")))
    elif element.attrib:
        key = random.choice(list(element.attrib))
        value = element.attrib[key]
        if action == "key":
            element.attrib[random.choice(("name", "type", "class", "xyz", "pos", "quat", "x"))] = element.attrib.pop(
                key
            )
            return
        many = " ".join([random.choice(NUMBERS)] * random.choice((1, 2, 3, 4, 1000)))
        other = random.choice(elements).attrib.get(key, "")
        element.attrib[key] = _clean(
            random.choice((*random.sample(TEXTS, 5), many, many, value * 2, value[:-1], other, ""))
        )


def _clean(text: str) -> str:
    return "".join(c for c in text if c in "\t\n\r" or c >= " ")


def table(content: bytes, random: Random) -> bytes:
    """A CSV table."""
    rows = list(csv.reader(io.StringIO(content.decode())))
    for _ in range(random.choice((1, 1, 2, 3))):
        _edit_rows(rows, random)
    text = io.StringIO()
    separator = random.choice((",", ",", ",", ",", ";", "\t", "|"))
    quoting = random.choice((csv.QUOTE_MINIMAL, csv.QUOTE_MINIMAL, csv.QUOTE_ALL))
    csv.writer(text, delimiter=separator, quoting=quoting, lineterminator="\n").writerows(rows)
    return text.getvalue().encode()


def _edit_rows(rows: list[list[str]], random: Random) -> None:
    row = random.randrange(len(rows))
    width = max(map(len, rows))
    column = random.randrange(max(width, 1))
    action = random.choice(
        ("cell", "cell", "cell", "drop", "column", "again", "head", "short", "long", "shuffle", "all", "wide", "rows")
    )
    if action == "cell" and column < len(rows[row]):
        rows[row][column] = random.choice((*NUMBERS, *TEXTS))
    elif action == "all":
        value = random.choice([v for v in (*NUMBERS, *TEXTS) if len(v) < 1000])
        for other in rows[1:]:
            other[column : column + 1] = [value]
    elif action == "drop" and len(rows) > 1:
        del rows[row]
    elif action == "column":
        for other in rows:
            del other[column : column + 1]
    elif action == "again":
        rows[row:row] = [list(rows[row])] * random.choice((1, 2, 500))
    elif action == "head" and rows[0]:
        rows[0][column % len(rows[0])] = random.choice((*rows[0], *TEXTS))
    elif action == "short":
        del rows[row][column:]
    elif action == "long":
        rows[row] += [random.choice(NUMBERS)] * random.choice((1, 5, 5000))
    elif action == "shuffle":
        random.shuffle(rows)
    elif action == "wide":
        n = random.choice((10, 3000))
        for k, other in enumerate(rows[:50]):
            other += [f"c{j}" if k == 0 else "0" for j in range(n)]
    elif action == "rows":
        del rows[random.choice((0, 1, 2)) :]
        rows += [[]] * (not rows)


def parquet(content: bytes, random: Random) -> bytes:
    import pyarrow as pa
    import pyarrow.parquet as pq

    found = pq.read_table(pa.BufferReader(content))
    for _ in range(random.choice((1, 1, 2))):
        found = _edit_columns(found, random)
    sink = pa.BufferOutputStream()
    compression = random.choice(("snappy", "zstd", "gzip", "none"))
    version = random.choice(("1.0", "2.6"))
    pq.write_table(
        found, sink, compression=compression, version=version, data_page_version=random.choice(("1.0", "2.0"))
    )
    return sink.getvalue().to_pybytes()


def _edit_columns(found: Any, random: Random) -> Any:
    import pyarrow as pa

    if not found.num_columns:
        return found
    k = random.randrange(found.num_columns)
    name, n = found.column_names[k], found.num_rows
    old = found.column(k).to_pylist()
    made = {
        "text": lambda: pa.array([str(v) for v in old]),
        "words": lambda: pa.array([random.choice(TEXTS) for _ in old], pa.string()),
        "nothing": lambda: pa.nulls(n),
        "gaps": lambda: pa.array([None if random.random() < 0.3 else v for v in old]),
        "nan": lambda: pa.array([float("nan") if random.random() < 0.3 else v for v in old]),
        "huge": lambda: pa.array([random.choice((1e308, -1e308, 1e-320, 0.0)) for _ in old]),
        "float32": lambda: pa.array(old, pa.float64()).cast(pa.float32()),
        "bool": lambda: pa.array([bool(k % 2) for k in range(n)]),
        "lists": lambda: pa.array([[v, v] for v in old]),
        "struct": lambda: pa.array([{"a": v} for v in old]),
        "map": lambda: pa.array([[("a", 1)]] * n, pa.map_(pa.string(), pa.int64())),
        "bytes": lambda: pa.array([b"\xff\0"] * n, pa.binary()),
        "integer": lambda: pa.array([2**63 - 1] * n, pa.int64()),
        "unsigned": lambda: pa.array([2**64 - 1] * n, pa.uint64()),
        "stamp": lambda: pa.array([datetime(2020, 1, 1, tzinfo=UTC)] * n, pa.timestamp("ns", tz="UTC")),
        "time": lambda: pa.array([1] * n, pa.time64("us")),
        "decimal": lambda: pa.array([1] * n).cast(pa.decimal128(38, 0)),
        "dictionary": lambda: pa.array([str(v) for v in old]).dictionary_encode(),
        "long text": lambda: pa.array(["A" * 20_000] * n),
    }
    action = random.choice((*made, "rename", "drop", "again", "rows", "no rows", "wide"))
    if action in made:
        return found.set_column(k, name, made[action]())
    if action == "rename":
        return found.rename_columns(
            [random.choice((*TEXTS[:30], name)) if j == k else c for j, c in enumerate(found.column_names)]
        )
    if action == "drop":
        return found.remove_column(k)
    if action == "again":
        return found.append_column(name, found.column(k))
    if action == "wide":
        return reduce(lambda t, j: t.append_column(f"c{j}", t.column(0)), range(300), found)
    if action == "no rows":
        return found.slice(0, 0)
    rows = random.choice((1, 2, 3, n))
    return found.take([random.randrange(n) for _ in range(rows)]) if n else found


def nmea(content: bytes, random: Random) -> bytes:
    """Fields of sentences, their checksums made right again; lines dropped, repeated, shuffled."""
    lines = content.decode().split("\r\n")
    for _ in range(random.choice((1, 3, 20))):
        k = random.randrange(len(lines))
        stamp, dollar, rest = lines[k].partition("$")
        fields = rest.partition("*")[0].split(",")
        action = random.choice(("field", "field", "field", "drop", "again", "short", "long", "stamp", "swap", "name"))
        j = random.randrange(len(fields))
        if action == "field":
            fields[j] = random.choice((*NUMBERS, *TEXTS[:30]))
        elif action == "short":
            del fields[j + 1 :]
        elif action == "long":
            fields += ["1"] * random.choice((1, 30, 2000))
        elif action == "name":
            fields[0] = random.choice(("PASHR", "PSXN", "PRDID", "IIXDR", "HEHDT", "GPZDA", "GPGGA", "PUBX", "XX"))
        elif action == "stamp":
            stamp = random.choice((*NUMBERS, *TEXTS[:20], "9999-12-31T23:59:59.999999 "))
        body = ",".join(fields)
        lines[k] = f"{stamp}{dollar}{body}*{reduce(lambda a, b: a ^ b, body.encode(), 0):02X}"
        if action == "drop":
            del lines[k : k + random.choice((1, 10))]
        elif action == "again":
            lines[k:k] = lines[k : k + 20] * random.choice((1, 5))
        elif action == "swap":
            other = random.randrange(len(lines))
            lines[k], lines[other] = lines[other], lines[k]
        lines = lines or [""]
    return "\r\n".join(lines).encode(errors="replace")


_STATEMENTS = (
    "update messages set data = NULL where id % 3 = 0",
    "update messages set data = 'text'",
    "update messages set data = zeroblob(100000) where id = 3",
    "update messages set data = substr(data, 1, 20) where id % 2 = 0",
    "update messages set timestamp = 9223372036854775807 where id = 5",
    "update messages set timestamp = -1",
    "update messages set timestamp = 'noon' where id = 5",
    "update messages set topic_id = 77",
    "update topics set type = 'sensor_msgs/msg/Nothing'",
    "update topics set type = NULL",
    "update topics set serialization_format = 'json'",
    "insert into topics select id + 10, name || 'x', type, serialization_format, offered_qos_profiles, '' from topics",
    "update topics set offered_qos_profiles = '[[[[[[' ",
    "delete from messages",
    "delete from topics",
    "drop table messages",
    "alter table messages rename column data to dat",
    "create view more as select * from messages",
)


def sqlite(content: bytes, random: Random) -> bytes:
    base = sqlite3.connect(":memory:", isolation_level=None)
    base.deserialize(content)
    for _ in range(random.choice((1, 2))):
        try:
            base.execute(random.choice(_STATEMENTS))
        except sqlite3.Error:
            break
    spoiled = base.serialize()
    base.close()
    return spoiled
