"""What all figures share: their style, the methods' colours, and SVG whose bytes depend on the results alone."""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from kincal.urdf.errors import one_line

STYLE: Any = {"svg.hashsalt": "kincal", "svg.fonttype": "none", "font.size": 9, "font.family": "sans-serif"}
BLUE, RED, GREY = "#1f5fa8", "#b3261e", "#767676"
_LONGEST = 36  # letters of a name
COLOURS = {
    "nominal": GREY,
    "geometric": BLUE,
    "network": "#c98a00",
    "transfer": "#7a3e9d",
    "transfer_identified": "#2a9d8f",
    "hybrid": RED,
}


def svg(figure: Figure) -> str:
    buffer = io.StringIO()
    with any_letters():
        FigureCanvasSVG(figure).print_svg(buffer, metadata={"Date": None, "Creator": None})
    return buffer.getvalue()


def label(name: str) -> str:
    """A name, whatever stands in it, for a figure; to be drawn with parse_math=False: it is no formula."""
    name = one_line(name)
    return name if len(name) <= _LONGEST else f"{name[: _LONGEST - 3]}..."


@contextmanager
def any_letters() -> Iterator[None]:
    """Without a warning for each letter that matplotlib's own font has not got: who looks at the figure has others."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing")
        yield


def inline(document: str, name: str = "") -> str:
    """An SVG as it stands in a page: without what comes before its element.

    name: of the figure, where there are others on the page: the names within stay apart from theirs.
    """
    element = document[document.index("<svg") :]
    return re.sub(r'(\bid="|url\(#|href="#)', rf"\g<1>{name}-", element) if name else element


def clean(axes: Any, grid: str = "both") -> None:
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(alpha=0.25, axis=grid)


def quartile_line(axes: Any, method: str, x: np.ndarray, median: np.ndarray, low: np.ndarray, high: np.ndarray) -> None:
    """A method's median and quartiles (n,) over seeds."""
    axes.plot(x, median, "o-", ms=2.5, lw=1.2, color=COLOURS[method], label=method)
    axes.fill_between(x, low, high, color=COLOURS[method], alpha=0.18, lw=0)
