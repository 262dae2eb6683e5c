"""Write `jax_aero/config.py`, the types of a flight's configuration, from the crate's schema."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

Node = Mapping[str, Any]

HEAD = '''"""Types of a flight's configuration, as `make generated` writes them; `configs/schema` describes every key.

A list is a tuple, and a table of several kinds the union of a type for each: `AeroConfig` with `model = "off"` is an
`OffAeroConfig`. `jax_aero.base.typed` fills them.

>>> ChannelConfig(delay=0.02)
ChannelConfig(delay=0.02, time_constant=0.0)
"""

from __future__ import annotations

from typing import Literal, TypeAlias

from msgspec import Struct, field
'''
SCALARS = {"number": "float", "integer": "int", "string": "str", "boolean": "bool", "null": "None"}


def module(schema: Node) -> str:
    """Return the text of the module of a schema."""
    tables = {**schema["$defs"], schema["title"]: schema}
    written: dict[str, str] = {}

    def write(name: str) -> None:
        """Write a definition of the schema after those that it names, which are its defaults."""
        for inner in _names(tables[name]):
            if inner not in written:
                write(inner)
        written[name] = "".join(_definition(name, tables[name], tables))

    write(schema["title"])
    return HEAD + "".join(written.values())


def _names(node: Any) -> Iterator[str]:
    """Yield the names of the definitions in a part of a schema."""
    if isinstance(node, Mapping):
        if "$ref" in node:
            yield node["$ref"].rpartition("/")[2]
        node = [part for key, part in node.items() if key != "$defs"]
    if isinstance(node, list):
        for part in node:
            yield from _names(part)


def _definition(name: str, node: Node, tables: Mapping[str, Node]) -> Iterator[str]:
    options = node.get("oneOf", ())
    if kinds := [option for option in options if "properties" in option]:
        for kind in kinds:
            tag, value = _tag(kind)
            yield _table(_kind_name(name, value), kind, tables, f', tag_field="{tag}", tag="{value}"')
        union = " | ".join(_kind_name(name, _tag(kind)[1]) for kind in kinds)
        yield f"\n\n{name}: TypeAlias = {union}\n"
    elif names := node.get("enum") or [option["const"] for option in options]:
        yield f"\n{name}: TypeAlias = Literal[{', '.join(map(json.dumps, names))}]\n"
    else:
        yield _table(name, node, tables)


def _tag(kind: Node) -> tuple[str, str]:
    """Return the key that is constant in one kind of a table, and its value."""
    ((key, part),) = ((key, part) for key, part in kind["properties"].items() if "const" in part)
    return key, part["const"]


def _kind_name(name: str, value: str) -> str:
    return "".join(map(str.title, value.split("_"))) + name


def _table(name: str, node: Node, tables: Mapping[str, Node], tag: str = "") -> str:
    fields = {key: part for key, part in node.get("properties", {}).items() if "const" not in part}
    lines = [_field(key, part, key in node.get("required", ()), tables) for key, part in fields.items()]
    return f"\n\nclass {name}(Struct, frozen=True, kw_only=True{tag}):\n" + "".join(lines or ["    pass\n"])


def _field(key: str, node: Node, is_required: bool, tables: Mapping[str, Node]) -> str:
    default = "" if is_required else _value(node, node.get("default"), tables)
    if key == "lambda":  # a word of Python
        return f'    lambda_: {_type(node)} = field(name="lambda"{default and f", default={default}"})\n'
    return f"    {key}: {_type(node)}{default and f' = {default}'}\n"


def _type(node: Node) -> str:
    if "$ref" in node:
        return str(node["$ref"].rpartition("/")[2])
    if "anyOf" in node:
        return " | ".join(map(_type, node["anyOf"]))
    kind = node["type"]
    if isinstance(kind, list):
        return " | ".join(_type({**node, "type": each}) for each in kind)
    if kind == "array":
        item, bounds = _type(_item(node)), [node.get("minItems"), node.get("maxItems")]
        return f"tuple[{', '.join([item] * bounds[0] if bounds[0] and bounds[0] == bounds[1] else [item, '...'])}]"
    return f"dict[str, {_type(node['additionalProperties'])}]" if kind == "object" else SCALARS[kind]


def _item(node: Node) -> Node:
    """Return the schema of the items of a list."""
    found: Node = node.get("items") or node["prefixItems"][0]
    return found


def _value(node: Node, value: Any, tables: Mapping[str, Node]) -> str:
    """Return a default as Python."""
    if isinstance(value, Mapping) and value:
        name = _type(node)
        table = tables[name]
        for kind in table.get("oneOf", ()):
            key, tag = _tag(kind)
            if value[key] == tag:
                name, table = _kind_name(name, tag), kind
        parts = {
            key: part for key, part in table["properties"].items() if value.get(key, "") != part.get("default", "")
        }
        given = [f"{key}={_value(part, value[key], tables)}" for key, part in parts.items() if "const" not in part]
        return f"{name}({', '.join(given)})"
    if isinstance(value, Mapping):
        return f"{_type(node)}()" if "$ref" in node else "{}"
    if isinstance(value, list):
        items = [_value(_item(node), item, tables) for item in value]
        return f"({', '.join(items)}{',' * (len(items) == 1)})"
    return json.dumps(value) if isinstance(value, str) else repr(value)
