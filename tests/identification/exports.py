"""Exports of motion capture software, written as Motive and Qualisys Track Manager write them."""

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

QUATERNION = ["qx", "qy", "qz", "qw"]


def motive(
    bodies: dict[str, pd.DataFrame], unit: str = "Meters", rotation: str = "Quaternion", named: bool = True
) -> str:
    """bodies: {name: frame, t, x, y, z (and qx .. qw; without: a marker)}; NaN: blank cells.

    named: as format 1.24 does, "Type", "Name" and "ID" stand before the names, and there is a line of parents.
    """
    factor = {"Meters": 1.0, "Centimeters": 100.0, "Millimeters": 1000.0}[unit]
    kinds, names, parts, axes, columns = [], [], [], [], []
    for name, table in bodies.items():
        position = factor * table[["x", "y", "z"]].to_numpy()
        groups = [("Position", "XYZ", position)]
        if "qx" in table:
            groups.insert(0, ("Rotation", *turned(table, rotation)))
        for part, letters, values in groups:
            kinds += ["Rigid Body" if "qx" in table else "Marker"] * len(letters)
            names += [name] * len(letters)
            parts += [part] * len(letters)
            axes += letters
            columns += list(values.T)
        kinds, names, parts, axes = (
            [*row, x] for row, x in ((kinds, kinds[-1]), (names, name), (parts, "Error Per Marker"), (axes, ""))
        )
        columns.append(np.full(len(table), 0.0001))
    first = f"Format Version,1.23,Take Name,Take 1,Export Frame Rate,120.0,Rotation Type,{rotation},Length Units,{unit}"
    lead = [["", "Type"], ["", "Name"], ["", "ID"], ["", "Parent"]] if named else [["", ""]] * 3
    rows = [kinds, [f'"{name}"' for name in names], ['"7A:1"'] * len(names), [""] * len(names)]
    lines = [first, "", *(",".join(a + b) for a, b in zip(lead, rows, strict=False))]
    lines += [",".join(["", "", *parts]), ",".join(["Frame", "Time (Seconds)", *axes])]
    table = next(iter(bodies.values()))
    for k in range(len(table)):
        cells = ["" if np.isnan(column[k]) else repr(float(column[k])) for column in columns]
        lines.append(",".join([str(int(table["frame"][k])), f"{table['t'][k]:.6f}", *cells]))
    return "\n".join(lines) + "\n"


def turned(table: pd.DataFrame, notation: str) -> tuple[str, np.ndarray]:
    """Letters of the columns and their values (n, 3 or 4); angles in degrees, each by its axis."""
    quaternion = table[QUATERNION].to_numpy()
    if notation == "Quaternion":
        return "XYZW", quaternion
    angles = np.full((len(table), 3), np.nan)
    known = np.isfinite(quaternion).all(axis=1)
    angles[known] = Rotation.from_quat(quaternion[known]).as_euler(notation, degrees=True)
    return "XYZ", angles[:, [notation.index(axis) for axis in "XYZ"]]


def qualisys(bodies: dict[str, pd.DataFrame], columns: bool = True, time: bool = True, blank: bool = False) -> str:
    """As `motive`. columns: the line of names; time: columns Frame and Time; blank: gaps are blanks, not zeros."""
    table = next(iter(bodies.values()))
    solid = "qx" in table
    lines = [
        f"NO_OF_FRAMES\t{len(table)}",
        "NO_OF_CAMERAS\t8",
        f"NO_OF_{'BODIES' if solid else 'MARKERS'}\t{len(bodies)}",
    ]
    lines += ["FREQUENCY\t100", "DESCRIPTION\t--", "TIME_STAMP\t2026-01-01, 10:00:00.000\t11.5"]
    lines += [
        f"DATA_INCLUDED\t{'6D' if solid else '3D'}",
        "\t".join(["BODY_NAMES" if solid else "MARKER_NAMES", *bodies]),
    ]
    of_body = [
        "X",
        "Y",
        "Z",
        *(["Roll", "Pitch", "Yaw", "Residual", *(f"Rot[{k}]" for k in range(9))] if solid else []),
    ]
    names = [f"{name} {part}" if part == "X" or not solid else part for name in bodies for part in of_body]
    if columns:
        lines.append("\t".join([*(["Frame", "Time"] if time else []), *names]) + "\t")
    for k in range(len(table)):
        cells = [str(int(table["frame"][k])), f"{table['t'][k]:.5f}"] if time else []
        for body in bodies.values():
            row = body.iloc[k]
            values = np.full(len(of_body), np.nan)
            if np.isfinite(row["x"]):
                values[:3] = 1000 * row[["x", "y", "z"]].to_numpy(float)
            if np.isfinite(row["x"]) and solid:
                rotation = Rotation.from_quat(row[QUATERNION].to_numpy(float))
                values[3:7] = [*rotation.as_euler("XYZ", degrees=True), 0.5]
                values[7:] = rotation.as_matrix().T.ravel()
            cells += ["" if blank and np.isnan(v) else f"{np.nan_to_num(v):.9f}" for v in values]
        lines.append("\t".join(cells) + "\t")
    return "\n".join(lines) + "\n"
