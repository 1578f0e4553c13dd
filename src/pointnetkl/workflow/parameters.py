"""Read sections of a parameter file as typed settings; wrong types and unknown names are errors."""

import dataclasses
import math
import types
import typing
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

import yaml

from pointnetkl.workflow.errors import PointNetKLError

T = TypeVar("T")

# in C where PyYAML was built with it, six times as fast; a stage reads several sections
_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


class SettingsError(PointNetKLError):
    """A parameter is missing, unknown or of the wrong type."""


def read(path: Path, section: str, kind: type[T]) -> T:
    """Return one section of a YAML parameter file as the dataclass `kind`.

    `section` may be dotted (`study.surveys.baltic`). Fields may be int, float, str, bool, another dataclass,
    `list[...]`, `dict[str, ...]`, or a union of those with None. A dataclass refuses values by a ValueError from
    `__post_init__` whose text begins with the field's name.

    Raises:
        SettingsError: the file, section or a field is missing, unknown, of the wrong type or refused.
    """
    value: Any = _load(path)
    for name in section.split("."):
        if not isinstance(value, dict) or name not in value:
            names = ", ".join(map(str, value)) if isinstance(value, dict) and value else "nothing"
            raise SettingsError(f"{path}: there is no {section}; at {name!r} the file has {names}")
        value = value[name]
    return typing.cast(T, _convert(value, kind, f"{path}: {section}"))


def sections(path: Path) -> list[str]:
    """Return the names of a parameter file's sections.

    Raises:
        SettingsError: the file is missing or no YAML.
    """
    content = _load(path)
    return list(map(str, content)) if isinstance(content, dict) else []


def as_metadata(settings: object) -> dict[str, Any]:
    """Return a settings dataclass as plain values, for an artifact's metadata."""
    return dataclasses.asdict(settings)  # type: ignore[call-overload]


def from_metadata(metadata: Mapping[str, Any], section: str, kind: type[T], origin: Path) -> T:
    """Return a section of an artifact's metadata, written by `as_metadata`, as the dataclass `kind`.

    Raises:
        SettingsError: the metadata lacks the section, or the section does not fit `kind`.
    """
    if not isinstance(metadata, Mapping) or section not in metadata:
        raise SettingsError(f"{origin}: does not say with which {section} it was made; run its stage again (dvc repro)")
    return typing.cast(T, _convert(metadata[section], kind, f"{origin}: {section}"))


def require_positive(settings: object, *names: str) -> None:
    """Refuse, from a dataclass's `__post_init__`, numbers that are not above zero.

    Raises:
        ValueError: one of the named fields is zero or negative.
    """
    for name in names:
        if not getattr(settings, name) > 0:
            raise ValueError(f"{name} is {getattr(settings, name)!r}, must be above zero")


def require_within(settings: object, lowest: float, highest: float, *names: str) -> None:
    """Refuse, from a dataclass's `__post_init__`, numbers outside a range.

    Raises:
        ValueError: one of the named fields is below `lowest` or above `highest`.
    """
    for name in names:
        if not lowest <= getattr(settings, name) <= highest:
            raise ValueError(f"{name} is {getattr(settings, name)!r}, must be from {lowest:g} to {highest:g}")


def require_seed(seed: int) -> None:
    """Refuse, from a dataclass's `__post_init__`, a seed that NumPy would refuse.

    Raises:
        ValueError: the seed is negative.
    """
    if seed < 0:
        raise ValueError(f"seed is {seed}, must be 0 or above")


def _load(path: Path) -> Any:
    try:
        return yaml.load(path.read_text(), _LOADER)
    except OSError as error:
        raise SettingsError(f"{path}: cannot be read ({error.strerror}); name your parameters with --params") from error
    except UnicodeDecodeError as error:
        raise SettingsError(f"{path}: is not a text file; write it in UTF-8") from error
    except yaml.YAMLError as error:
        raise SettingsError(f"{path}: is not valid YAML ({' '.join(str(error).split())})") from error


def _convert(value: Any, kind: Any, where: str) -> Any:
    if dataclasses.is_dataclass(kind):
        return _convert_section(value, kind, where)
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    if origin in (types.UnionType, typing.Union):
        if value is None and type(None) in inner:
            return None
        return _convert(value, next(k for k in inner if k is not type(None)), where)
    if origin is list and isinstance(value, list):
        return [_convert(v, inner[0], f"{where}[{i}]") for i, v in enumerate(value)]
    if origin is dict and isinstance(value, dict):
        return {_convert(k, inner[0], where): _convert(v, inner[1], f"{where}.{k}") for k, v in value.items()}
    if kind is float and type(value) is int:
        return float(value)
    # an exact match, because bool passes for int; infinity and NaN would pass for numbers
    if type(value) is not kind or (kind is float and not math.isfinite(value)):
        raise SettingsError(_wrong_type(value, kind, where))
    return value


def _convert_section(value: Any, kind: Any, where: str) -> Any:
    if not isinstance(value, dict):
        raise SettingsError(f"{where} must be a group of settings, not {value!r}")
    fields = {field.name: field for field in dataclasses.fields(kind)}
    hints = typing.get_type_hints(kind)
    if unknown := [name for name in value if name not in fields]:
        raise SettingsError(f"{where}.{unknown[0]} is unknown; it has {', '.join(fields)}")
    if missing := [name for name, field in fields.items() if name not in value and _is_required(field)]:
        raise SettingsError(f"{where}.{missing[0]} is missing")
    values = {name: _convert(v, hints[name], f"{where}.{name}") for name, v in value.items()}
    try:
        return kind(**values)
    except ValueError as error:
        raise SettingsError(f"{where}.{error}") from error


def _is_required(field: "dataclasses.Field[Any]") -> bool:
    return field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING


def _wrong_type(value: Any, kind: Any, where: str) -> str:
    expected = {float: "a finite number", int: "a whole number", str: "text", bool: "true or false"}.get(
        kind, str(kind)
    )
    # YAML, and so `dvc exp run -S`, reads 1e-4 as text; with a point it is a number
    hint = "; write it with a point, as 1.0e-4" if kind is float and isinstance(value, str) else ""
    return f"{where} is {value!r}, must be {expected}{hint}"
