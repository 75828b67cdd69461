"""What a result was made of: command, seed, versions, digests of files and stages. Times stand in manifests alone."""

from __future__ import annotations

import json
import platform
from collections.abc import Iterable, Mapping
from typing import Any

from markupsafe import escape

from kincal.pipeline.run.stage import all_stages, needed, version
from kincal.pipeline.store.manifest import Entry


def provenance(entries: Mapping[str, Entry], stages: Iterable[str], command: str) -> dict[str, Any]:
    """Of a document that was made, by `command`, of the results of these stages."""
    names = {stage.name for name in stages for stage in needed(name)}
    used = {name: entries[name] for name in all_stages() if name in names}
    parts = [entry.manifest["parts"] for entry in used.values()]
    return {
        "command": command,
        "seed": next((p["settings"]["seed"] for p in parts if "seed" in p["settings"]), None),
        "versions": versions(used.values()),
        "files": {name: digest for p in parts for name, digest in p["files"].items()},
        "inputs": {name: entry.digest for name, entry in used.items()},
    }


def versions(entries: Iterable[Entry] = (), libraries: Iterable[str] = ()) -> dict[str, str]:
    """Of kincal, Python, the libraries that these artifacts were made with, and these libraries."""
    by_name = {name: version(name) for name in libraries}
    for entry in entries:
        by_name |= entry.manifest["provenance"]["versions"]
    return {"kincal": version("kincal"), "python": platform.python_version()} | dict(sorted(by_name.items()))


def made_of(entries: Mapping[str, Entry], *stages: str) -> str:
    """One line for a comment: the first digits of contents; `kincal cache verify --json` has the whole."""
    return "made of " + ", ".join(f"{name} {entries[name].digest[:12]}" for name in stages)


def published(html: str, entries: Mapping[str, Entry]) -> bytes:
    """The report page for people, with its provenance at the end; the command is that which made the report."""
    made = entries["report"].manifest["provenance"]["command"]
    text = json.dumps(provenance(entries, ["report"], made), indent=1)
    footer = f"<footer><details open><summary>Provenance</summary><pre>{escape(text)}</pre></details></footer>\n</body>"
    return footer.join(html.rsplit("</body>", 1)).encode()
