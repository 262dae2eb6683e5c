"""Write `jax_aero/config.py`, the types of a flight's configuration, from the crate's schema."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from experiments.tools.schema import Node, choices_of, items, kinds, name_of
from jax_aero import rust
from jax_aero.base import places

HEAD = '''"""Types of a flight's configuration, as `make generated` writes them; `configs/schema` describes every key.

A list is a tuple, and a table of several kinds the union of a type for each: `AeroConfig` with `model = "off"` is an
`OffAeroConfig`. Tables that the crate alone reads are plain. `jax_aero.base.typed_config` fills them.

>>> FilterConfig(delay=0.02)
FilterConfig(delay=0.02, time_constant=0.0)
"""

from __future__ import annotations

from typing import Any, Literal, TypeAlias

from msgspec import Struct, field
'''
PLAIN = {
    "ChannelsConfig", "ContactConfig", "EnginesConfig", "FuelConfig", "GroundConfig", "JointsConfig",
    "LatencyDetectorConfig", "NonlinearConfig", "OwnController", "QpConfig", "ShaftConfig", "TrackingErrorConfig",
}  # fmt: skip
"""Tables that the crate alone reads: JAX reads at most whether they are given."""
SCALARS = {"number": "float", "integer": "int", "string": "str", "boolean": "bool", "null": "None"}


def files() -> dict[Path, str]:
    """Return the text of the module."""
    schema = rust.schemas()["experiments"]
    tables = {**schema["$defs"], schema["title"]: schema}
    written: dict[str, str] = {}

    def write(name: str) -> None:
        """Write a definition of the schema after those that it names, which are its defaults."""
        for inner in _names(tables[name]):
            if inner not in written:
                write(inner)
        written[name] = "".join(_definition(name, tables[name], tables))

    write(schema["title"])
    return {places.HOME / "jax_aero" / "config.py": HEAD + "".join(written.values())}


def _names(node: Any) -> Iterator[str]:
    """Yield the names of the definitions in a part of a schema."""
    if isinstance(node, dict):
        if "$ref" in node and name_of(node) not in PLAIN:
            yield name_of(node)
        node = [part for key, part in node.items() if key != "$defs"]
    if isinstance(node, list):
        for part in node:
            yield from _names(part)


def _definition(name: str, node: Node, tables: Mapping[str, Node]) -> Iterator[str]:
    if choices := choices_of(node):
        yield f"\n{name}: TypeAlias = Literal[{', '.join(map(json.dumps, choices))}]\n"
        return
    for tag, value, kind in kinds(node):
        yield _table(_kind_name(name, value), kind, tables, tag and f', tag_field="{tag}", tag="{value}"')
    if tag:
        union = " | ".join(_kind_name(name, value) for _, value, _ in kinds(node))
        yield f"\n\n{name}: TypeAlias = {union}\n"


def _kind_name(name: str, value: str) -> str:
    return "".join(map(str.title, value.split("_"))) + name


def _table(name: str, node: Node, tables: Mapping[str, Node], tag: str = "") -> str:
    fields = {key: part for key, part in node.get("properties", {}).items() if "const" not in part}
    lines = [_field(key, part, key in node.get("required", ()), tables) for key, part in fields.items()]
    return f"\n\nclass {name}(Struct, frozen=True, kw_only=True{tag}):\n" + "".join(lines or ["    pass\n"])


def _field(key: str, node: Node, is_required: bool, tables: Mapping[str, Node]) -> str:
    default = "" if is_required else _value(node, node.get("default"), tables)
    kind = _type(node)
    if default == "None" and "None" not in kind:  # an empty list that is not written
        kind += " | None"
    if key == "lambda":  # a word of Python
        return f'    lambda_: {kind} = field(name="lambda"{default and f", default={default}"})\n'
    return f"    {key}: {kind}{default and f' = {default}'}\n"


def _type(node: Node) -> str:
    if "$ref" in node:
        return "dict[str, Any]" if name_of(node) in PLAIN else name_of(node)
    if "anyOf" in node:
        return " | ".join(map(_type, node["anyOf"]))
    kind = node["type"]
    if isinstance(kind, list):
        return " | ".join(_type({**node, "type": each}) for each in kind)
    if kind == "array":
        item, bounds = _type(items(node)), [node.get("minItems"), node.get("maxItems")]
        return f"tuple[{', '.join([item] * bounds[0] if bounds[0] and bounds[0] == bounds[1] else [item, '...'])}]"
    return f"dict[str, {_type(node['additionalProperties'])}]" if kind == "object" else SCALARS[kind]


def _value(node: Node, value: Any, tables: Mapping[str, Node]) -> str:
    """Return a default as Python."""
    if isinstance(value, Mapping) and "$ref" in node:
        if name_of(node) in PLAIN:
            return "{}"
        keys = tables[_type(node)]["properties"].items()
        other = {key: part for key, part in keys if key in value and value[key] != part.get("default")}
        given = [f"{key}={_value(part, value[key], tables)}" for key, part in other.items()]
        return f"{_type(node)}({', '.join(given)})"
    if isinstance(value, list):
        entries = [_value(items(node), entry, tables) for entry in value]
        return f"({', '.join(entries)}{',' * (len(entries) == 1)})"
    return json.dumps(value) if isinstance(value, str) else repr(value)
