"""The source files of kincal, each once: `Path.rglob` does not enter the links of src/kincal."""

from pathlib import Path

ROOT = Path(__file__).parents[1]
FOLDERS = ("src", "urdf", "identification", "learning", "pipeline")


def sources(pattern: str = "*.py") -> list[Path]:
    return sorted(file for folder in FOLDERS for file in (ROOT / folder).rglob(pattern))
