"""The report: one page that needs nothing else, says everything, and believes no name."""

import re
import shutil
from html.parser import HTMLParser
from pathlib import Path

import pytest

from kincal.pipeline.methods.predictors import METHODS
from kincal.pipeline.report.inspection import direction_lines

NAMES = (  # of XML vocabularies: identifiers that nobody fetches
    "http://www.w3.org/2000/svg",
    "http://www.w3.org/1999/xlink",
    "http://www.w3.org/1999/02/22-rdf-syntax-ns#",
    "http://purl.org/dc/elements/1.1/",
    "http://purl.org/dc/dcmitype/StillImage",
    "http://creativecommons.org/ns#",
)
VOID = {"meta", "br", "hr", "img", "input", "link", "path", "use", "rect", "circle", "line"}
HOSTILE = "<img src=x onerror=alert(1)>&\"'"


class Page(HTMLParser):
    """Tags, attributes and text of a page."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str, str]] = []
        self.open: list[str] = []
        self.text = ""
        self.feed(html)
        self.close()

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        self.attributes += [(tag, name, value or "") for name, value in attributes]
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        if tag not in VOID:
            assert self.open.pop() == tag

    def handle_startendtag(self, tag, attributes):
        self.tags.append(tag)
        self.attributes += [(tag, name, value or "") for name, value in attributes]

    def handle_data(self, data):
        self.text += data


@pytest.fixture(scope="module")
def html(start, finished) -> str:
    return str(start(finished.store, *finished.settings)[0].until("report")[0].html)


@pytest.fixture(scope="module")
def page(html) -> Page:
    return Page(html)


def test_it_is_well_formed(html, page):
    assert html.startswith("<!doctype html>")
    assert page.open == []
    assert len(re.findall(r"<svg\b", html)) >= 3


def test_it_needs_nothing_else(html, page):
    """No network, no other file, no script."""
    for address in re.findall(r"https?://[^\s\"'<>)]*", html):
        assert address in NAMES, address
    for tag, name, value in page.attributes:
        if name in ("src", "href", "xlink:href", "srcset", "data", "action", "poster"):
            assert value.startswith("#"), f"<{tag} {name}={value}>"
        assert not name.startswith("on"), f"<{tag} {name}>"
    assert not {"script", "iframe", "object", "embed", "link", "base", "form"} & set(page.tags)
    assert "@import" not in html
    assert all(target.startswith("#") for target in re.findall(r"url\(['\"]?([^)]*)", html))


def test_it_names_every_method_and_parameter(page, start, finished):
    shipped = start(finished.store, *finished.settings)[0].until("identify")[0].shipped
    for name in (*METHODS, *shipped.names, *shipped.channels, "nominal, raw"):
        assert name in page.text, name
    for direction in direction_lines(shipped.unobservable):
        assert direction in page.text


def test_its_numbers_are_those_of_the_comparison(page, finished):
    for method in finished.comparison.methods:
        assert f"{method.mean_deg:.3g}" in page.text


def test_the_same_run_gives_the_same_bytes(html, start, finished, tmp_path):
    """No clock, no random identifiers in the figures."""
    store = shutil.copytree(finished.store, tmp_path / "store")
    run, events = start(Path(store), *finished.settings, force_from="report")
    assert str(run.until("report")[0].html) == html
    assert "ran" in {e.state for e in events}


def test_hostile_names_are_escaped(start, finished, robot_folder, tmp_path):
    """Of a file and of a joint; a robot's own name may have no such characters."""
    urdf = robot_folder / "robot.urdf"
    urdf.write_text(urdf.read_text().replace("leg1_u1", "&lt;img src=x onerror=alert(1)&gt;"))
    table = tmp_path / f"{HOSTILE}.csv"
    finished.table.to_csv(table, index=False)
    settings = ("split.test=0.5", "measure.source=files", f"measure.table='''{table}'''")
    run, _ = start(tmp_path / "store", *settings, robot=robot_folder)
    page = Page(str(run.until("report")[0].html))
    assert HOSTILE in page.text
    assert "<img src=x onerror=alert(1)>.x" in page.text
    assert "img" not in page.tags
