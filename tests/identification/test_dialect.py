"""Text tables as recorders and spreadsheets write them: each is read as the plain one, by what it holds."""

import io

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kincal.identification.column_names import matched, misspelt, unused
from kincal.identification.measurement_table import noted_table, read_table
from kincal.identification.table_files import load
from kincal.urdf.description import Measure
from kincal.urdf.errors import InputError

JOINTS = ("slide_1", "slide_2", "Hinge")
SEPARATORS = {",": "comma", ";": "semicolon", "\t": "tab", "|": "bar", " ": "blank"}


def plain(n: int, seed: int) -> pd.DataFrame:
    random = np.random.default_rng(seed)
    table = pd.DataFrame({"pose": np.arange(3, 3 + n)})
    for name in (*JOINTS, "x", "y", "z", "roll", "pitch", "yaw"):
        table[name] = random.normal(size=n).round(6)
    return table


def written(table: pd.DataFrame, separator: str, decimal: str, **more) -> str:
    text = table.to_csv(index=False, sep=separator, decimal=decimal, lineterminator="\n", **more)
    return text


@st.composite
def layouts(draw):
    separator = draw(st.sampled_from(list(SEPARATORS)))
    decimal = draw(st.sampled_from([".", ","])) if separator != "," else "."
    encoding = draw(st.sampled_from(["utf-8", "utf-8-sig", "utf-16", "cp1252"]))
    above = draw(st.lists(st.sampled_from(["# made by a tracker", "Serial no: 12", "", "% 3 bodies"]), max_size=4))
    units = draw(st.booleans())
    trailing = draw(st.booleans()) and separator not in (" ", "\t")
    crlf = draw(st.booleans())
    capitals = draw(st.booleans())
    return separator, decimal, encoding, above, units, trailing, crlf, capitals


@given(layout=layouts(), seed=st.integers(0, 50), n=st.integers(3, 12))
def test_every_way_of_writing_gives_the_same_table(tmp_path_factory, layout, seed, n):
    """Separator, decimal sign, encoding, lines above, a row of units, trailing separators, line ends, capitals."""
    separator, decimal, encoding, above, units, trailing, crlf, capitals = layout
    table = plain(n, seed)
    head, *rows = written(table, separator, decimal).splitlines()
    if units:
        rows = [separator.join(["-", "m", "mm", "rad", "mm", "mm", "mm", "deg", "deg", "deg"]), *rows]
    rows = [row + separator for row in rows] if trailing else rows
    head = head.upper().replace("HINGE", "hinge ") if capitals and separator != " " else head
    text = ("\r\n" if crlf else "\n").join([*above, head, *rows]) + "\n"
    file = tmp_path_factory.mktemp("table") / "table.csv"
    file.write_bytes(text.encode(encoding))
    expected = table.copy()
    if units:
        expected["slide_2"] *= 1e-3
        expected[["x", "y", "z"]] *= 1e-3
        expected[["roll", "pitch", "yaw"]] *= np.pi / 180
    found = read_table(file, JOINTS, Measure(table=file))
    pd.testing.assert_frame_equal(found[list(expected)], expected, check_dtype=False, rtol=1e-12)


def test_what_was_recognised_is_named_with_its_key(tmp_path):
    file = tmp_path / "table.csv"
    file.write_bytes(("made by hand\n" + written(plain(5, 1), ";", ",")).encode("utf-16"))
    notes = " ".join(noted_table(file, JOINTS, Measure(table=file))[1])
    for key in (
        'measure.encoding = "utf-16"',
        'measure.separator = ";"',
        'measure.decimal = ","',
        "measure.header_row = 2",
    ):
        assert key in notes
    file.write_text(written(plain(5, 1), ",", "."))
    assert noted_table(file, JOINTS, Measure(table=file))[1] == ()


@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_blanks_inside_of_names_separate_nothing(tmp_path, separator):
    """Not even where the words between them are names that a table has."""
    table, file = plain(6, 5), tmp_path / "table.csv"
    foreign = {name: f"Value of {name} now" for name in table if name != "pose"}
    file.write_text(written(table.rename(columns=foreign), separator, "."))
    columns = {name: {"from": column} for name, column in foreign.items()}
    found = read_table(file, JOINTS, Measure.model_validate({"table": file, "columns": columns}))
    pd.testing.assert_frame_equal(found[list(table)], table, check_dtype=False, rtol=1e-12)
    assert list(load(file, Measure(table=file))) == ["pose", *foreign.values()]


@pytest.mark.parametrize("kind", ["xlsx"])
def test_a_workbook(tmp_path, kind):
    """Its second sheet, below two rows of remarks, with units; written by hand as the standard has it."""
    table = plain(6, 2)
    rows = [["Campaign", 12], [], list(table), ["", "m", "m", "rad", "mm", "mm", "mm"], *table.to_numpy().tolist()]
    file = tmp_path / f"table.{kind}"
    file.write_bytes(workbook_of({"remarks": [["nothing here"]], "poses": rows}))
    expected = table.copy()
    expected[["x", "y", "z"]] *= 1e-3
    found, notes = noted_table(file, JOINTS, Measure(table=file))
    pd.testing.assert_frame_equal(found[list(expected)], expected, check_dtype=False, rtol=1e-12)
    assert "read sheet 'poses'" in " ".join(notes)


def workbook_of(sheets: dict[str, list[list[object]]]) -> bytes:
    """The least that ECMA-376 asks of a workbook."""
    import zipfile
    from xml.sax.saxutils import escape

    def cell(value: object) -> str:
        if isinstance(value, str):
            return f'<c t="inlineStr"><is><t>{escape(value)}</t></is></c>'
        return f"<c><v>{value!r}</v></c>"

    main = "http://schemas.openxmlformats.org/spreadsheetml/2006/main"
    office = "http://schemas.openxmlformats.org/officeDocument/2006/relationships"
    package = "http://schemas.openxmlformats.org/package/2006"
    names = list(enumerate(sheets, 1))
    listed = "".join(f'<sheet name="{name}" sheetId="{k}" r:id="r{k}"/>' for k, name in names)
    relations = "".join(f'<Relationship Id="r{k}" Type="{office}/worksheet" Target="s{k}.xml"/>' for k, _ in names)
    sheet_type = "application/vnd.openxmlformats-officedocument.spreadsheetml"
    parts = "".join(f'<Override PartName="/xl/s{k}.xml" ContentType="{sheet_type}.worksheet+xml"/>' for k, _ in names)
    files = {
        "[Content_Types].xml": f'<Types xmlns="{package}/content-types"><Default Extension="rels" ContentType='
        f'"application/vnd.openxmlformats-package.relationships+xml"/><Override PartName="/xl/workbook.xml" '
        f'ContentType="{sheet_type}.sheet.main+xml"/>{parts}</Types>',
        "_rels/.rels": f'<Relationships xmlns="{package}/relationships"><Relationship Id="r1" '
        f'Type="{office}/officeDocument" Target="xl/workbook.xml"/></Relationships>',
        "xl/workbook.xml": f'<workbook xmlns="{main}" xmlns:r="{office}"><sheets>{listed}</sheets></workbook>',
        "xl/_rels/workbook.xml.rels": f'<Relationships xmlns="{package}/relationships">{relations}</Relationships>',
    }
    for k, name in names:
        rows = "".join(f"<row>{''.join(map(cell, row))}</row>" for row in sheets[name])
        files[f"xl/s{k}.xml"] = f'<worksheet xmlns="{main}"><sheetData>{rows}</sheetData></worksheet>'
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        for name, text in files.items():
            archive.writestr(name, text)
    return content.getvalue()


def test_rows_without_a_measurement_are_skipped_and_counted(tmp_path):
    file, table = tmp_path / "table.csv", plain(8, 3)
    table.loc[[2, 5], ["x", "y", "z", "roll", "pitch", "yaw"]] = np.nan
    table.to_csv(file, index=False)
    found, notes = noted_table(file, JOINTS, Measure(table=file))
    assert found["pose"].tolist() == [3, 4, 6, 7, 9, 10]
    assert "2 of 8 rows have no measurement and are skipped: rows 3, 6" in " ".join(notes)
    table.loc[4, "x"] = np.nan
    table.to_csv(file, index=False)
    with pytest.raises(InputError, match="column 'x', row 5: found nan"):
        read_table(file, JOINTS, Measure(table=file))


# Names of columns


def test_names_are_matched_where_that_is_unambiguous():
    assert matched(["X", " y ", "z"], ["x", "y", "z"]) == {"x": "X", "y": " y ", "z": "z"}
    assert matched(["leg", "LEG"], ["leg", "LEG"]) == {"leg": "leg", "LEG": "LEG"}
    assert matched(["LEG"], ["leg", "Leg"]) == {}  # two joints: neither is taken
    assert matched(["Leg", "LEG"], ["leg"]) == {}  # two columns: neither is taken
    assert matched(["\ufb01le"], ["file"]) == {"file": "\ufb01le"}  # a ligature


@given(st.lists(st.text(min_size=1, max_size=8), max_size=6, unique=True), st.lists(st.text(max_size=8), max_size=6))
def test_a_column_has_one_name_and_a_name_one_column(present, wanted):
    found = matched(present, wanted)
    assert len(set(found.values())) == len(found)
    assert set(found) <= set(wanted)
    assert set(found.values()) | set(unused(present, found.values())) == set(present)
    assert all(found[name] == name for name in wanted if name in present)


def test_near_names_are_an_error_and_others_a_note(tmp_path):
    file, table = tmp_path / "table.csv", plain(5, 4)
    table.assign(positon_std=1e-3).to_csv(file, index=False)
    with pytest.raises(InputError, match="'positon_std' is not used; did you mean 'position_std'"):
        read_table(file, JOINTS, Measure(table=file))
    table.assign(temperature=20.0, planned_x_mm=1.0).to_csv(file, index=False)
    notes = noted_table(file, JOINTS, Measure(table=file))[1]
    assert len(notes) == 1
    assert notes[0].endswith("column temperature is not used")
    assert misspelt(["x2", "rolls"], ["x", "roll"]) is None  # too short to be sure
