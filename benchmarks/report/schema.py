"""JSON files whose shape is defined once, by frozen dataclasses: their JSON Schema, a check, and reading them back."""

from __future__ import annotations

import json
import types
from collections.abc import Callable, Mapping
from dataclasses import MISSING, asdict, fields, is_dataclass
from pathlib import Path
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

from hybrid.errors import ConfigError, DataError, describe
from hybrid.files import make_folder, write_bytes

Record = TypeVar("Record")

_PLAIN: dict[Any, Any] = {
    int: {"type": "integer"},
    float: {"type": "number"},
    str: {"type": "string"},
    bool: {"type": "boolean"},
    type(None): {"type": "null"},
    Any: {},
}
_TYPES: dict[str, tuple[type, ...]] = {
    "integer": (int,),
    "number": (int, float),
    "string": (str,),
    "boolean": (bool,),
    "null": (type(None),),
    "array": (list,),
    "object": (dict,),
}


def schema_of(kind: Any) -> dict[str, Any]:
    """JSON Schema (2020-12) of a dataclass, or of the types that its fields may have.

    These are plain values, tuples of one type, ``dict[str, X]``, unions, and dataclasses.
    """
    if kind in _PLAIN:
        return dict(_PLAIN[kind])
    if is_dataclass(kind):
        hints = get_type_hints(kind)
        needed = [f.name for f in fields(kind) if f.default is MISSING and f.default_factory is MISSING]
        properties = {name: schema_of(hint) for name, hint in hints.items()}
        return {"type": "object", "properties": properties, "required": needed, "additionalProperties": False}
    origin, inner = get_origin(kind), get_args(kind)
    if origin in (Union, types.UnionType):
        return {"anyOf": [schema_of(one) for one in inner]}
    if origin is tuple and set(inner[1:]) <= {..., inner[0]}:
        return {"type": "array", "items": schema_of(inner[0])}
    if origin in (dict, Mapping) and inner[0] is str:
        return {"type": "object", "additionalProperties": schema_of(inner[1])}
    raise TypeError(f"schema_of: no schema for {kind}")


def problems(value: Any, schema: Mapping[str, Any], at: str = "$") -> list[str]:
    """Where a JSON value violates the schema; empty if nowhere. Knows the keywords that ``schema_of`` writes."""
    if "anyOf" in schema:
        tried = [problems(value, one, at) for one in schema["anyOf"]]
        return [] if not all(tried) else min(tried, key=len)
    kind = schema.get("type")
    if kind is None:
        return []
    if not isinstance(value, _TYPES[kind]) or (isinstance(value, bool) and kind != "boolean"):
        return [f"{at}: got {type(value).__name__}, allowed {kind}"]
    if isinstance(value, list):
        return [p for k, item in enumerate(value) for p in problems(item, schema["items"], f"{at}[{k}]")]
    if not isinstance(value, dict):
        return []
    known, other = schema.get("properties", {}), schema["additionalProperties"]
    found = [f"{at}: no {name}" for name in schema.get("required", ()) if name not in value]
    for name, item in value.items():
        if name in known:
            found += problems(item, known[name], f"{at}.{name}")
        elif other is False:
            found.append(f"{at}: unknown {name}")
        else:
            found += problems(item, other, f"{at}.{name}")
    return found


def write_record(path: Path, record: Any) -> None:
    """Write a dataclass as a JSON file, whole or not at all, creating its folder."""
    make_folder(path.parent, "--out or --json")
    write_bytes(path, (json.dumps(asdict(record), indent=1, allow_nan=False) + "\n").encode())


def keep_settings(path: Path, settings: Any, *results: Path) -> None:
    """Write what determines the results beside them. results: their folders; until one holds any, all settings will do.

    Raises:
        ConfigError: there are results made with other settings, which are not combined with new ones.
    """
    any_there = any(True for folder in results for _ in folder.glob("*.json"))
    if any_there and path.exists() and read_record(path, type(settings)) != settings:
        do = "Name another folder by --out, or run with the options and the commit that are in that file."
        raise ConfigError(describe(what="--out", where=path, got="results of other settings", do=do))
    write_record(path, settings)


def read_record(path: Path, kind: type[Record]) -> Record:
    """Read what ``write_record`` wrote.

    Raises:
        DataError: no such file, no JSON, or JSON of another shape.
    """
    try:
        value = json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise DataError(describe(what="results", where=path, got=f"'{error}'", do="Run the benchmark again.")) from None
    wrong = problems(value, schema_of(kind))
    if wrong:
        got = f"{wrong[0]} (and {len(wrong) - 1} more)" if wrong[1:] else wrong[0]
        raise DataError(describe(what="results", where=path, got=got, do="Run the benchmark again, elsewhere."))
    return _built(value, kind)


def kept(path: Path, kind: type[Record], make: Callable[[], Record | None]) -> Record | None:
    """Read a file, or else make its contents now and write them there: how a run that was cut off continues.

    A file of another shape is made again; None is not written, and is tried again the next time.
    """
    if path.exists():
        try:
            return read_record(path, kind)
        except DataError:
            path.unlink()
    made = make()
    if made is not None:
        write_record(path, made)
    return made


def _built(value: Any, kind: Any) -> Any:
    """A JSON value as the type from which the schema was made."""
    if is_dataclass(kind) and isinstance(kind, type):
        hints = get_type_hints(kind)
        return kind(**{name: _built(item, hints[name]) for name, item in value.items()})
    origin, inner = get_origin(kind), get_args(kind)
    if origin in (Union, types.UnionType):
        fitting = [one for one in inner if not problems(value, schema_of(one))]
        return _built(value, fitting[0])
    if origin is tuple:
        return tuple(_built(item, inner[0]) for item in value)
    if origin in (dict, Mapping):
        return {name: _built(item, inner[1]) for name, item in value.items()}
    return float(value) if kind is float else value


__all__ = ["keep_settings", "kept", "problems", "read_record", "schema_of", "write_record"]
