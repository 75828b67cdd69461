"""How pages are made: jinja2, with everything escaped that is not said to be markup."""

from __future__ import annotations

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from pipeline.fingerprint import ROOT


def environment() -> Environment:
    """Of the templates; what a page asks for and nobody gives is an error."""
    loader = FileSystemLoader(ROOT / "pipeline" / "templates")
    return Environment(loader=loader, autoescape=True, undefined=StrictUndefined)
