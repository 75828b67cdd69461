"""Names of robots, links and joints may be any text: what is exported quotes them, and says the same when read back."""

import subprocess
import tomllib
import xml.etree.ElementTree as Xml
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kincal.identification.compiled import find_compiler
from kincal.identification.error_model import ErrorModel
from kincal.pipeline.compensator.code import _comment, quoted
from kincal.pipeline.export.toml import exported_toml
from kincal.pipeline.export.urdf import calibrated_urdf
from kincal.urdf.closed_chain import load_chain
from kincal.urdf.description import ROBOTS, RobotDescription, load_robot
from kincal.urdf.kinematics import at_home

NASTY = (
    *('"', "'", "\\", "\\n", "*/", "/*", "//", "??/", "??'", "%s%n", "\n", "\r\n", "\t", "a\nb"),
    *("<script>alert(1)</script>", "&amp;"),
    *("&", "]]>", "--", "-->", "<!--", "int", "while", "0", "1e5", "a b", " lead", "$x^", "$\\frac", "{{7*7}}"),
    *("${HOME}", "\u202e"),
    *("é", "\U0001f916", "\u00a0", "\ufeff", "[x]", "a.b", "=", "#", "a" * 300, "true", "\\u0041", ","),
)  # fmt: skip
# what XML can't hold, nobody's drawing has; and it makes a carriage return a line feed
NAMES = st.text(
    st.characters(exclude_categories=("Cs", "Cc"), exclude_characters="\ufffe\uffff", include_characters="\t\n"),
    min_size=1,
    max_size=40,
)

PROGRAM = """
{comments}
#include <stdio.h>
#include <string.h>
static const char *const names[] = {{ {names} }};
int main(void) {{
  size_t i;
  for (i = 0; i < sizeof names / sizeof *names; ++i) {{
    unsigned length = (unsigned)strlen(names[i]);
    fwrite(&length, sizeof length, 1, stdout);
    fwrite(names[i], 1, length, stdout);
  }}
  return 0;
}}
"""


def printed(names: list[str], folder: Path) -> list[str]:
    """The names as a C program says them that has them in literals and in comments."""
    comments = "\n".join(f"/* {line} */" for name in names for line in _comment(name))
    text = PROGRAM.format(comments=comments, names=", ".join(map(quoted, names)))
    (folder / "names.c").write_text(text, encoding="utf-8")
    # trigraphs as a strict compiler reads them; comments that begin within comments are warned of
    strict = ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror", "-O0", "-o", str(folder / "names")]
    subprocess.run([find_compiler(), *strict, str(folder / "names.c")], check=True, timeout=60)
    said, found = subprocess.run([folder / "names"], capture_output=True, check=True, timeout=10).stdout, []
    while said:
        length = int(np.frombuffer(said[:4], np.uint32)[0])
        found.append(said[4 : 4 + length].decode())
        said = said[4 + length :]
    return found


def test_c_says_any_name(tmp_path):
    if find_compiler() is None:
        pytest.skip("there is no C compiler here")

    @settings(max_examples=4)
    @given(st.lists(NAMES, min_size=40, max_size=80))
    def check(names):
        names = [*NASTY, *names]
        assert printed(names, tmp_path) == names

    check()


def renamed(names: dict[str, str]) -> tuple[str, RobotDescription]:
    """ups3_s with other names of links and joints: its URDF and its description."""
    root = Xml.fromstring((ROBOTS / "ups3_s" / "robot.urdf").read_text())
    for element in root.iter():
        for key in ("name", "link"):
            if element.tag in ("link", "joint", "parent", "child") and key in element.attrib:
                element.set(key, names.get(element.attrib[key], element.attrib[key]))
    described = load_robot("ups3_s").description
    loops = tuple(
        loop.model_copy(update={"frames": tuple(names.get(f, f) for f in loop.frames)}) for loop in described.loop
    )
    update = {
        "actuated": tuple(names.get(j, j) for j in described.actuated),
        "tool_frame": names.get(described.tool_frame, described.tool_frame),
        "loop": loops,
    }
    return Xml.tostring(root, encoding="unicode"), described.model_copy(update=update)


RENAMED = ("leg1_slide", "leg2_slide", "leg1_tip", "platform", "leg1_rod")


@settings(max_examples=15)
@given(
    st.lists(
        st.one_of(st.sampled_from(NASTY), NAMES), min_size=5, max_size=5, unique_by=lambda name: " ".join(name.split())
    )
)
def test_a_urdf_and_a_robot_toml_say_any_name(tmp_path_factory, names):
    names = [name.replace("\r\n", "\n") for name in names]
    text, described = renamed(dict(zip(RENAMED, names, strict=True)))
    chain = at_home(load_chain(described.mechanism, text, Path("robot.urdf")), None)
    robot = ErrorModel.of(chain, {}, described.tolerance)
    built = robot.robot(np.full(len(robot.parameters), 1e-4))
    exported = calibrated_urdf(text, built, described.mechanism, [f"identified: {names}"])
    again = load_chain(described.mechanism, exported.text, Path("exported.urdf"))
    assert again.joint_names == chain.joint_names
    assert set(names[:2]) <= set(again.joint_names)
    np.testing.assert_allclose(
        again.translation[: chain.n_joints], built.chain.translation[: chain.n_joints], atol=1e-12
    )
    folder = tmp_path_factory.mktemp("exported")
    gone = folder / "gone.toml"
    said = exported_toml(described, gone, folder, [f"of {names}"])
    assert tomllib.loads(said)["actuated"] == list(described.actuated)
    (folder / "robot.toml").write_text(said, encoding="utf-8")
    assert load_robot(str(folder)).description.mechanism == described.mechanism


def test_figures_show_any_name():
    """No formula, no element: text."""
    from matplotlib import rc_context

    from kincal.identification.identification import Identification
    from kincal.pipeline.report.figures import STYLE
    from kincal.pipeline.report.identification_figures import changes, shares
    from kincal.pipeline.report.page import _drawn

    n, blank = len(NASTY), dict.fromkeys(Identification.__dataclass_fields__)
    values = {"observable_share": np.ones(n), "data_share": np.ones(n), "change": np.ones(n), "std": np.ones(n)}
    found = Identification(**blank | values | {"names": NASTY, "tolerance": np.ones(n)})
    for draw in (changes, lambda f, axes: shares(f, axes, names=True)):
        with rc_context(STYLE):
            figure = _drawn(draw, found, 3.0)
        texts = {"".join(element.itertext()).strip() for element in Xml.fromstring(str(figure)).iter()}
        assert {"$x^", "<script>alert(1)</script>", "&amp;", "]]>"} <= texts
