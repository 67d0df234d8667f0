"""Helpers of all readers: numbers from parsed files, and YAML without surprises."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

from rootmatch.cameras.pinhole import Camera
from rootmatch.errors import InputError, escape_unprintable, quote_value

LONGEST = 64
"""Maximum number of values in one entry: a camera's matrices and coefficients are shorter."""
IMAGE_SIZE = "image_width", "image_height"
"""Names of the size of an image, as OpenCV's calibration and ROS write them."""
LARGEST = 10_000_000
"""Maximum size of a calibration file in bytes."""

T = TypeVar("T")


@contextmanager
def prefix_errors(where: object) -> Iterator[None]:
    """Let each `InputError` of a block begin with a file, or with a place in it."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{where}: {str(error).removeprefix(f'{where}: ')}") from None


def run_parser(path: Path, kind: str, parse: Callable[[], T]) -> T:
    """The result of a parser on a file; nesting and numbers beyond its bounds become the one error of a bad file."""
    try:
        return parse()
    except RecursionError:
        raise InputError(f"{path}: nested too deeply for a calibration; give the file that the tool wrote") from None
    except InputError:
        raise
    except (ValueError, OverflowError, TypeError, SyntaxError) as error:
        line = escape_unprintable(" ".join(str(error).split()))[:160]
        raise InputError(f"{path}: not {kind} ({line}); give the file that the tool wrote") from None


def read_numbers(path: Path, name: str, value: Any) -> list[float]:
    """The numbers of an entry: a flat or a nested list, or a matrix as OpenCV writes it."""
    if isinstance(value, dict) and "data" in value:
        value = value["data"]
    if not isinstance(value, list):
        raise InputError(f"{path}: {name} is {quote_value(value)}; give a list of numbers")
    rows = value if value and all(isinstance(row, list) for row in value) else [value]
    if len({len(row) for row in rows}) != 1 or len(rows) * len(rows[0]) > LONGEST:
        raise InputError(f"{path}: {name} has rows of different lengths, or too many numbers; give a plain list")
    return [read_number(path, name, entry) for row in rows for entry in row]


def read_number(path: Path, name: str, value: Any) -> float:
    """One number of an entry; YAML takes 1e5 for text."""
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise InputError(f"{path}: {name} holds {quote_value(value)}; give numbers")
    try:
        return float(value)
    except (ValueError, OverflowError):
        raise InputError(f"{path}: {name} holds {quote_value(value)}; give numbers") from None


def read_3x3(path: Path, name: str, value: Any) -> list[list[float]]:
    """Nine numbers as a matrix (3, 3)."""
    flat = read_numbers(path, name, value)
    if len(flat) != 9:
        raise InputError(f"{path}: {name} has {len(flat)} numbers, 9 of a 3 × 3 matrix expected")
    return [flat[0:3], flat[3:6], flat[6:9]]


def with_image_size(camera: Camera, content: Mapping[str, Any], names: tuple[str, str]) -> Camera:
    """A camera with the size of its image, where the entries of these names say it: width and height."""
    width, height = (content.get(name) for name in names)
    return camera if width is None or height is None else replace(camera, size=(width, height))


def load_yaml(path: Path, text: str) -> Any:
    """The one document of a YAML file, OpenCV's matrices as mappings."""
    import yaml

    class Loader(yaml.SafeLoader):
        """PyYAML's safe loader with OpenCV's tag."""

    def mapping(loader: Any, node: Any) -> Any:
        return loader.construct_mapping(node, deep=True)

    Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", mapping)
    lines = text.splitlines(keepends=True)
    if lines and lines[0].startswith("%"):  # OpenCV 4 writes %YAML:1.0, which is none
        lines[0] = "\n"

    def load() -> Any:
        try:
            loader = Loader("".join(lines))
            try:
                node = loader.get_single_node()
                if node is None:
                    return None
                if _expanded_size(node, {}) > LARGEST:
                    raise ValueError(f"its aliases expand to more than {LARGEST:,} characters")
                return loader.construct_document(node)
            finally:
                loader.dispose()
        except yaml.YAMLError as error:
            raise ValueError(str(error)) from None

    return run_parser(path, "YAML", load)


def _expanded_size(node: Any, known: dict[int, int]) -> int:
    """Characters of a YAML node with each alias replaced by what it stands for, none of which is built.

    ``known`` holds that of nodes that were met before, 0 while a node's own content is counted.
    """
    size = known.get(id(node))
    if size == 0:
        raise ValueError("an alias refers to a list or mapping that contains it")
    if size is None:
        known[id(node)] = 0
        if isinstance(node.value, str):
            size = 1 + len(node.value)
        else:
            parts = [part for entry in node.value for part in (entry if isinstance(entry, tuple) else (entry,))]
            size = 1 + sum(_expanded_size(part, known) for part in parts)
        known[id(node)] = size
    return size
