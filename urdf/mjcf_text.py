"""How the numbers of an MJCF are written: <compiler>, default classes, and five ways to write an orientation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kincal.urdf.description import nearest
from kincal.urdf.drawing import MAX_NUMBER
from kincal.urdf.errors import InputError, quoted
from kincal.urdf.input_files import floats
from kincal.urdf.rigid_motion import Motion, exp

_DEEPEST = 100  # classes around a class
_ORIENTATIONS = {"quat": 4, "axisangle": 4, "euler": 3, "xyaxes": 6, "zaxis": 3}

Attributes = Mapping[str, str]
Classes = dict[str, dict[str, dict[str, str]]]  # {class: {element: attributes}}


@dataclass(frozen=True)
class MjcfText:
    """What <compiler> and <default> say of a file's numbers."""

    file: Path
    angle: float  # radians per unit
    sequence: str  # of Euler angles
    autolimits: bool
    classes: Classes

    @staticmethod
    def of(root, file: Path) -> MjcfText:
        settings: dict[str, str] = {}
        for compiler in root.findall("compiler"):
            settings |= compiler.attrib
        allowed = {"angle": ("degree", "radian"), "coordinate": ("local",), "autolimits": ("true", "false")}
        for key, values in allowed.items():
            setting = settings.get(key, values[0])
            if setting not in values:
                raise InputError(f"{file}: compiler: {key} is {quoted(setting)}; allowed are {', '.join(values)}")
        sequence = settings.get("eulerseq", "xyz")
        if len(sequence) != 3 or set(sequence.lower()) - set("xyz"):
            raise InputError(f"{file}: compiler: eulerseq is {quoted(sequence)}; allowed are three of x, y, z, X, Y, Z")
        radians = 1.0 if settings.get("angle") == "radian" else np.pi / 180
        text = MjcfText(file, radians, sequence, settings.get("autolimits") != "false", {"main": {}})
        for default in root.findall("default"):
            text._add_class(default, "main")
        return text

    def _add_class(self, default, name: str, depth: int = 0) -> None:
        """Read a class and those inside it; each starts as a copy of the one around it."""
        if depth > _DEEPEST:
            raise InputError(f"{self.file}: default: classes inside {depth} others; allowed are {_DEEPEST}")
        settings = self.classes[name]
        for element in default:
            if element.tag != "default":
                settings[element.tag] = _overlaid(settings.get(element.tag, {}), element.attrib)
        for inner in default.findall("default"):
            inner_name = inner.get("class")
            if not inner_name or inner_name in self.classes:
                problem = "a class without a name" if not inner_name else f"two classes are called {quoted(inner_name)}"
                raise InputError(f"{self.file}: default: {problem}; every class needs a name of its own")
            self.classes[inner_name] = {tag: dict(attributes) for tag, attributes in settings.items()}
            self._add_class(inner, inner_name, depth + 1)

    def attributes(self, element, childclass: str = "main", tag: str | None = None) -> Attributes:
        """An element's attributes, with those of its class where it says nothing."""
        name = element.get("class", childclass)
        if name not in self.classes:
            raise InputError(f"{self.file}: default class {quoted(name)} does not exist; {nearest(name, self.classes)}")
        return _overlaid(self.classes[name].get(tag or element.tag, {}), element.attrib)

    def numbers(self, attributes: Attributes, key: str, default: str, label: str) -> np.ndarray:
        """As many finite numbers as the default has."""
        text, n = attributes.get(key, default), len(default.split())
        try:
            values = np.array(floats(text))
        except ValueError:
            values = np.zeros(0)
        if len(values) != n or not np.all(np.abs(values) < (MAX_NUMBER if key != "range" else np.inf)):
            numbers = "one finite number" if n == 1 else f"{n} finite numbers"
            raise InputError(f"{self.file}: {label}: {key} is {quoted(text)}; allowed: {numbers}")
        return values

    def direction(self, attributes: Attributes, key: str, default: str, label: str) -> np.ndarray:
        return self._normalised(self.numbers(attributes, key, default, label), key, label)

    def _normalised(self, vector: np.ndarray, key: str, label: str) -> np.ndarray:
        length = np.linalg.norm(vector)
        if length < 1e-9:
            raise InputError(f"{self.file}: {label}: {key} is zero; allowed is a direction")
        return vector / length

    def placement(self, attributes: Attributes, label: str) -> Motion:
        """A pose in its parent: `pos` and one of five ways to write an orientation."""
        given = [key for key in _ORIENTATIONS if key in attributes]
        if len(given) > 1:
            raise InputError(f"{self.file}: {label}: has {given[0]} and {given[1]}; allowed is one orientation")
        rotation = self._orientation(attributes, given[0], label) if given else np.eye(3)
        return Motion(rotation, self.numbers(attributes, "pos", "0 0 0", label))

    def _orientation(self, attributes: Attributes, key: str, label: str) -> np.ndarray:
        values = self.numbers(attributes, key, " ".join("0" * _ORIENTATIONS[key]), label)
        if key == "quat":
            return from_quaternion(self._normalised(values, key, label))
        if key == "axisangle":
            return exp(self._normalised(values[:3], key, label) * values[3] * self.angle)
        if key == "xyaxes":
            x = self._normalised(values[:3], key, label)
            y = self._normalised(values[3:] - x * (x @ values[3:]), key, label)
            return np.stack([x, y, np.cross(x, y)], axis=1)
        if key == "zaxis":
            z = self._normalised(values, key, label)
            across = np.array([-z[1], z[0], 0.0])
            sine = np.linalg.norm(across)
            axis = across / sine if sine > 1e-10 else np.array([1.0, 0.0, 0.0])
            return exp(axis * np.arctan2(sine, z[2]))
        rotation = np.eye(3)
        for letter, angle in zip(self.sequence, values * self.angle, strict=True):  # upper case: about fixed axes
            turn = exp(angle * np.eye(3)["xyz".index(letter.lower())])
            rotation = rotation @ turn if letter.islower() else turn @ rotation
        return rotation


def _overlaid(defaults: Attributes, attributes: Attributes) -> dict[str, str]:
    """Own attributes over defaults; an orientation of one's own replaces one that is written another way."""
    if any(key in attributes for key in _ORIENTATIONS):
        defaults = {key: value for key, value in defaults.items() if key not in _ORIENTATIONS}
    return {key: value for key, value in {**defaults, **attributes}.items() if key != "class"}


def from_quaternion(wxyz: np.ndarray) -> np.ndarray:
    w, x, y, z = wxyz
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
