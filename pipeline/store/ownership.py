"""Who but this user can change a store: its seals keep off accidents, no persons."""

from __future__ import annotations

import logging
import os
import shlex
import stat
from pathlib import Path

PROMISE = (
    "A seal promises that an artifact is unchanged since kincal wrote it. "
    "It is no signature: a user who can write the store can write results and seals."
)
_warned: set[str] = set()  # of this process


def warn_of_others(root: Path) -> None:
    """Warn, once a process, of a store that other users can change. A group may share one."""
    for folder in (root, root / "artifacts"):
        text = _risk(folder)
        if text is not None:
            if text not in _warned:
                _warned.add(text)
                logging.getLogger("kincal.pipeline").warning("%s", text)
            return


def _risk(folder: Path) -> str | None:
    try:
        status = folder.stat()
    except (OSError, ValueError):  # not there yet; or no name that a file system has
        return None
    shown = shlex.quote(str(folder))
    if hasattr(os, "geteuid") and status.st_uid != os.geteuid():
        return (
            f"store {folder}: it belongs to another user, {_name(status.st_uid)}, who can change its results. "
            f"Choose another --store, or run chown -R {os.geteuid()} {shown} && chmod -R go-w {shown}"
        )
    if os.name == "posix" and status.st_mode & stat.S_IWOTH:
        mode = f"mode {status.st_mode & 0o7777:o}"
        return f"store {folder}: every user can change its results ({mode}). Run chmod -R o-w {shown}"
    return None


def _name(user: int) -> str:
    import pwd

    try:
        return pwd.getpwuid(user).pw_name
    except KeyError:
        return f"number {user}"
