"""A proposal as a robot.toml, with the reasons in comments; never over another file."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit import TOMLDocument
from tomlkit.items import InlineTable, Item, Table

from kincal.urdf.description import ROBOTS
from kincal.urdf.errors import InputError
from kincal.urdf.proposal import Proposal, propose
from kincal.urdf.proposed_loops import TOLERANCES, Meeting
from kincal.urdf.schema import FILE


@dataclass(frozen=True)
class Written:
    """A robot.toml that was written, and what to say of it."""

    file: Path
    summary: str
    remarks: tuple[str, ...]


def write_proposal(drawing: Path, output: Path | None = None) -> Written:
    """Propose a robot.toml for a URDF or an MJCF and write it to `output` (default: robot.toml beside the drawing).

    Raises InputError where the drawing can't be read, or the output exists or can't be written.
    """
    file = drawing.parent / "robot.toml" if output is None else output
    if file.exists() or file.is_symlink():
        raise InputError(f"{file}: exists already, and is left as it is; --output names another file")
    proposal = propose(drawing)
    text = robot_toml(proposal, drawing, file)
    try:
        with file.open("x", encoding="utf-8") as stream:
            stream.write(text)
    except OSError as error:
        raise InputError(f"{file}: can't be written: {error.strerror}") from None
    loops, free = proposal.n_loops, proposal.mobility
    counted = f"{loops} loop{'' if loops == 1 else 's'}, {free} degree{'' if free == 1 else 's'} of freedom"
    summary = f"{counted}, tool frame {proposal.mechanism.tool_frame!r}; a proposal, to be read and corrected"
    return Written(file, summary, tuple(remarks(proposal)))


def robot_toml(proposal: Proposal, drawing: Path, output: Path) -> str:
    """The text of `output` for a robot whose URDF or MJCF is the file `drawing`."""
    mechanism, document = proposal.mechanism, tomlkit.document()
    _say(document, f"Your editor checks this file once the schema is there: kincal schema --output {FILE}")
    _say(document, f"Proposed by `kincal init` from {drawing.name}: read every line before you trust it.")
    if proposal.problem:
        _say(document, f"NOT READY, kincal run refuses it: {proposal.problem}")
    _put(document, "name", _robot_name(proposal, drawing))
    _put(document, "urdf", Path(os.path.relpath(drawing.absolute(), output.absolute().parent)).as_posix())
    _put(document, "base_frame", mechanism.base_frame, "what everything hangs on; any frame that does not move")
    others = f"; on the same body: {_listed(proposal.spare_frames)}" if proposal.spare_frames else ""
    met = "where most loops and branches meet" if mechanism.loop or proposal.how == "file" else "the last frame"
    _put(document, "tool_frame", mechanism.tool_frame, f"{met}{others}")
    joints = tomlkit.array()
    for name in mechanism.actuated:
        joints.append(name)
    _put(document, "actuated", joints.multiline(len(" ".join(mechanism.actuated)) > 80))
    spare = f", in place of some: {_listed(proposal.spare_joints)}" if proposal.spare_joints else ""
    _say(document, f"as many as degrees of freedom ({proposal.mobility}){spare}")
    _put(document, "seed", 0)
    document.add(tomlkit.nl())
    _add_loops(document, proposal)
    document["workspace"] = _workspace(proposal)
    document["tolerance"] = _tolerance(proposal)
    document["sensor"] = _table(
        "one sigma of one reading, where the measurement table has no *_std column: your instrument's",
        ("orientation_deg", 0.006, "about each axis"),
        ("position_mm", 0.03, "along each axis"),
    )
    document["plan"] = _table("", ("poses", 150, "to measure"))
    document["measure"] = _measure(proposal)
    text = re.sub(r"\n{3,}", "\n\n", tomlkit.dumps(document))
    return f"#:schema ./{FILE}\n{text}"


def remarks(proposal: Proposal) -> Iterator[str]:
    """What the user should know at once, a line each."""
    nearer, near = (_millimetres(tolerance * proposal.size) for tolerance in TOLERANCES)
    if proposal.how == "nearly":
        gap = _millimetres(max(meeting.gap for meeting in proposal.meetings))
        yield f"no frames coincide within {nearer} as drawn; those of the loops are up to {gap} apart"
    elif proposal.how == "paired":
        yield (
            f"the drawing does not close its loops (not all of their frames are within {near}): "
            "they are a guess by names and distances; check every pair"
        )
    elif proposal.how == "none" and proposal.candidates:
        yield f"no frames of different branches coincide within {near} as drawn: no loops are proposed"
    if proposal.not_as_drawn:
        yield f"home is not as drawn ({proposal.not_as_drawn})"
    if proposal.problem:
        yield f"not ready: {proposal.problem}"


def _add_loops(document: TOMLDocument, proposal: Proposal) -> None:
    if proposal.how == "file":
        _say(document, "The loops are those of the file's <equality>; more can be named here.")
    elif proposal.how == "none" and not proposal.candidates:
        _say(document, "No loops: no frames of different branches coincide as drawn.")
    else:
        for remark in remarks(proposal):
            if not remark.startswith(("not ready", "home")):
                _say(document, remark[0].upper() + remark[1:] + ".")
    if proposal.meetings:
        loops = tomlkit.aot()
        for meeting, loop in zip(proposal.meetings, proposal.mechanism.loop, strict=True):
            table = tomlkit.table()
            _put(table, "name", loop.name)
            _put(table, "kind", loop.kind, _why(meeting, loop.kind, proposal))
            _put(table, "frames", list(loop.frames), _gap(meeting, proposal))
            loops.append(table)
        document.append("loop", loops)
    if proposal.candidates:
        how = "These coincide too, but add no equation" if proposal.meetings else "They may be among these"
        _say(document, f"{how}:")
        for meeting in proposal.candidates:
            _say(
                document,
                f"{meeting.ends[0].name} and {meeting.ends[1].name}: {_millimetres(meeting.gap)} apart as drawn",
            )
        document.add(tomlkit.nl())


def _why(meeting: Meeting, kind: str, proposal: Proposal) -> str:
    if kind == "frame":
        return "6 equations; point loops (3 equations, a ball) would leave too many degrees of freedom"
    if proposal.how in ("coinciding", "nearly") and meeting.turned < 1e-6:
        return "3 equations, a ball; the orientations coincide as well: frame (6 equations) if it is rigid there"
    return "3 equations, a ball; frame: 6"


def _gap(meeting: Meeting, proposal: Proposal) -> str:
    return "" if proposal.how == "coinciding" else f"{_millimetres(meeting.gap)} apart as drawn"


def _workspace(proposal: Proposal) -> Table:
    workspace = proposal.mechanism.workspace
    table = _table("of the tool about home, on the axes that tell the mechanism's motions apart best; widen it")
    if workspace.home_mm is not None:
        if proposal.not_as_drawn:
            _say(table, f"not as drawn: {proposal.not_as_drawn}")
        _put(table, "home_mm", list(workspace.home_mm), "in the base frame")
        _put(table, "home_rotation_deg", list(workspace.home_rotation_deg or (0, 0, 0)), "intrinsic XYZ")
    for key in ("translation_mm", "rotation_deg"):
        ranges = getattr(workspace, key)
        if ranges:
            inline: InlineTable = tomlkit.inline_table()
            for axis, bounds in ranges.items():
                inline.append(axis, [_short(v) for v in bounds])
            _put(table, key, inline)
    return table


def _tolerance(proposal: Proposal) -> Table:
    return _table(
        "one sigma of manufacture",
        ("position_mm", 0.3, "of a joint's placement"),
        ("rotation_deg", 0.03),
        ("actuator_zero_mm", 0.3, "of slides"),
        ("actuator_zero_deg", 0.03, "of the others"),
        ("actuator_gain", 1e-3, "relative"),
    )


def _measure(proposal: Proposal) -> Table:
    table = _table("", ("source", "virtual", "a robot with known errors measures itself; for yours, name a table:"))
    example = proposal.mechanism.actuated[0]
    for line in (
        'table = "poses.csv" # in place of source: one row a pose, a column a joint, and what was measured',
        'channels = ["orientation", "position"] # what the virtual robot measures; or "tilt", "yaw"',
    ):
        _say(table, line)
    _say(table, "A reading that is no length or angle gets its gain and zero in a table of its own:")
    _say(table, f"[actuator.{tomlkit.key(example).as_string()}]")
    _say(table, "gain = 1.0 # metres or radians per unit; joint value = zero + gain * reading")
    return table


def _table(comment: str, *rows: tuple[Any, ...]) -> Table:
    table = tomlkit.table()
    if comment:
        table.comment(_line(comment))
    for key, value, *why in rows:
        _put(table, key, value, *why)
    return table


def _put(place: Any, key: str, value: Any, comment: str = "") -> None:
    item: Item = tomlkit.item(value)
    if comment:
        item.comment(_line(comment))
    place.add(key, item)


def _say(place: Any, text: str) -> None:
    place.add(tomlkit.comment(_line(text)))


def _line(text: str) -> str:
    """Names are the file's: whatever stands in them, a comment stays one line."""
    return "".join(c if c.isprintable() else " " for c in " ".join(text.split()) if c)


def _listed(names: tuple[str, ...]) -> str:
    text = ", ".join(names[:8])
    return f"{text}, .." if len(names) > 8 else text


def _millimetres(metres: float) -> str:
    return f"{float(f'{1e3 * metres:.2g}'):g} mm"


def _short(value: float) -> float | int:
    return int(value) if value == int(value) else value


def _robot_name(proposal: Proposal, drawing: Path) -> str:
    """The drawing's, unless a robot that comes with kincal has it: then the folder's."""
    name = _name(proposal.name or drawing.stem)
    return _name(drawing.absolute().parent.name) if (ROBOTS / name).is_dir() else name


def _name(name: str) -> str:
    """As robot.toml allows it."""
    return re.sub(r"[^A-Za-z0-9_.\-]", "_", name).lstrip("_.-")[:64] or "robot"
