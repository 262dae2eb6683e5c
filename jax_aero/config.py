"""Types of a flight's configuration, made of the crate's schema; `configs/schema` describes every key.

A table is a frozen `msgspec.Struct` and a list a tuple. A table of several kinds is the union of a type for each:
`AeroConfig` with `model = "off"` is an `OffAeroConfig`. `jax_aero.base.typed` fills them.

>>> ChannelConfig(delay=0.02)
ChannelConfig(delay=0.02, time_constant=0.0)
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import reduce
from operator import or_
from types import GenericAlias
from typing import Any, Literal

import msgspec

from jax_aero import rust

SCALARS = {"number": float, "integer": int, "string": str, "boolean": bool, "null": None}
_schema = rust.schemas()["experiments"]
_tables: Mapping[str, Any] = {**_schema["$defs"], _schema["title"]: _schema}
_types: dict[str, Any] = {}


def _named(name: str) -> Any:
    """Return the type of a definition of the schema."""
    if name not in _types:
        node = _tables[name]
        options = node.get("oneOf", ())
        names = node.get("enum") or [option["const"] for option in options if "const" in option]
        kinds = [_kind(name, option) for option in options if "properties" in option]
        _types[name] = reduce(or_, kinds) if kinds else Literal[tuple(names)] if names else _table(name, node)
    return _types[name]


def _kind(name: str, node: Mapping[str, Any]) -> Any:
    """Return the type of one kind of a table, which has the value of its key that is constant in its name."""
    (tag,) = (key for key, part in node["properties"].items() if "const" in part)
    kind = node["properties"][tag]["const"]
    rest = {key: part for key, part in node["properties"].items() if key != tag}
    full = "".join(map(str.title, kind.split("_"))) + name
    _types[full] = _table(full, {**node, "properties": rest}, tag_field=tag, tag=kind)
    return _types[full]


def _table(name: str, node: Mapping[str, Any], **tag: Any) -> Any:
    fields = [_field(key, part, key in node.get("required", ())) for key, part in node.get("properties", {}).items()]
    return msgspec.defstruct(name, fields, frozen=True, kw_only=True, module=__name__, **tag)


def _field(key: str, node: Mapping[str, Any], is_required: bool) -> tuple[str, Any, Any]:
    kind, name = _type(node), f"{key}_" if key == "lambda" else key
    if is_required:
        return name, kind, msgspec.field(name=key)
    default = msgspec.convert(node.get("default"), kind)
    given = {"default_factory": dict} if default == {} else {"default": default}
    return name, kind, msgspec.field(name=key, **given)


def _type(node: Mapping[str, Any]) -> Any:
    if "$ref" in node:
        return _named(node["$ref"].rpartition("/")[2])
    if "anyOf" in node:
        return reduce(or_, map(_type, node["anyOf"]))
    kind = node["type"]
    if isinstance(kind, list):
        return reduce(or_, (_type({**node, "type": each}) for each in kind))
    if kind == "array":
        item, length = _type(node.get("items") or node["prefixItems"][0]), node.get("minItems")
        is_fixed = length == node.get("maxItems")
        return GenericAlias(tuple, (item,) * length if length is not None and is_fixed else (item, ...))
    return GenericAlias(dict, (str, _type(node["additionalProperties"]))) if kind == "object" else SCALARS[kind]


for _name in _tables:
    _named(_name)
globals().update(_types)


def _refuse(name: str) -> Any:
    raise AttributeError(f"module {__name__} has no attribute {name}")


__getattr__: Any = _refuse  # for mypy, names that no file states are of any type
