"""The files that follow from the configuration's types; `python -m experiments.tools.generated` writes them.

The crate's types define flights and robots. Their JSON Schemas yield the schemas of `configs/schema/`, with which
editors complete keys. The schemas of studies, sweeps and trainings come from the Python types that read them.
`reference` is the documentation's page of all keys.
"""

from __future__ import annotations

import copy
import importlib
import json
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from jax_aero import rust
from jax_aero.base import places, tables
from jax_aero.cfd import design as cfd
from jax_aero.cfd.settings import FlowConfig
from jax_aero.commands import study as studies
from jax_aero.robot import waypoints
from jax_aero.sweep.perturbation import Perturbation
from jax_aero.sweep.spec import Axis, Spec
from jax_aero.train.config import Training
from jax_aero.train.from_flights import FlightTraining
from jax_aero.train.search import SearchConfig

Node = dict[str, Any]

TYPES: dict[str, Any] = {
    "cfd": cfd.Spec,
    "cfd_flow": FlowConfig,
    "perturbation": Perturbation,
    "sweep_axes": Axis,
    "sweeps": Spec,
    "training": Training,
    "training_flights": FlightTraining,
    "training_search": SearchConfig,
    "waypoints": waypoints.Waypoints,
}
"""Types that only Python reads, by the name of their schema."""

DIALECT = "https://json-schema.org/draft/2020-12/schema"
PAGE = "reference/configuration.md"
"""Path of the page of all keys in the documentation."""


def files() -> dict[Path, str]:
    """Return the text of every generated file."""
    crate = rust.schemas()
    schemas = refer_to_files({name: allow_parts(schema) for name, schema in crate.items()})
    schemas |= {name: {"$schema": DIALECT, **tables.schema(kind)} for name, kind in TYPES.items()}
    schemas["sweeps"] = _with_files(schemas["sweeps"])
    folder = places.CONFIGS / "schema"
    return {
        **{folder / f"{name}.schema.json": _json(schema) for name, schema in sorted(schemas.items())},
        **{path: _json({"$schema": DIALECT, **allow_parts(tables.schema(kind))}) for path, kind in _of_studies()},
    }


def _of_studies() -> Iterator[tuple[Path, Any]]:
    """Yield file and type of the schema of every study that has configurations."""
    for name in studies.names():
        if places.names(name):
            study = importlib.import_module(f"experiments.studies.{name}.study").STUDY
            yield studies.FOLDER / name / "schema.json", study.config


def _json(schema: Node) -> str:
    return json.dumps(_simplify(schema), indent=1, ensure_ascii=False, sort_keys=True) + "\n"


def _simplify(node: Any) -> Any:
    """Return a schema without parts that editors do not support: number formats, and brackets escaped for rustdoc."""
    if isinstance(node, dict):
        kept = {key: _simplify(value) for key, value in node.items() if key != "format" or value == "path"}
        if isinstance(kept.get("description"), str):
            kept["description"] = _prose(kept["description"])
        return kept
    return [_simplify(entry) for entry in node] if isinstance(node, list) else node


def allow_parts(schema: Node) -> Node:
    """Return the schema of files in which any table may leave keys to the file that it names as its `base`.

    What is missing then is refused when the files have been merged. A key that may be absent is removed by `false`.
    """
    partial = copy.deepcopy(schema)
    for node in _nodes(partial):
        _say_absent(node)
        if "properties" in node:
            node.pop("required", None)
            text = "File whose table is read first; the keys beside `base` are laid over it."
            node["properties"]["base"] = {"type": "string", "format": "path", "description": text}
        if any("properties" in option for option in node.get("oneOf", ())):
            node["anyOf"] = node.pop("oneOf")  # without its kind, a table may be several
    return partial


def refer_to_files(schemas: Mapping[str, Node]) -> dict[str, Node]:
    """Return schemas in which a type that has a file of its own is a reference to that file."""
    file_of = {schema["title"]: f"{name}.schema.json" for name, schema in schemas.items()}
    referring = {}
    for name, schema in schemas.items():
        changed = copy.deepcopy(schema)
        definitions = changed.pop("$defs", {})
        kept: dict[str, Node] = {}

        def follow(node: Node, definitions: Node = definitions, kept: dict[str, Node] = kept) -> None:
            for inner in _nodes(node):
                kind = str(inner.get("$ref", "")).removeprefix("#/$defs/")
                if kind in file_of:
                    inner["$ref"] = file_of[kind]
                elif kind in definitions and kind not in kept:
                    kept[kind] = definitions[kind]
                    follow(definitions[kind])

        follow(changed)
        referring[name] = {**changed, "$defs": kept} if kept else changed
    return referring


def _say_absent(node: Node) -> None:
    """Put `false` in the place of the `null` of a key that may be absent, which no file can hold."""
    absent = {"const": False, "description": "Nothing, whatever the file below says."}
    if isinstance(node.get("type"), list) and "null" in node["type"]:
        kept = {key: node.pop(key) for key in list(node) if key not in ("description", "default")}
        node["anyOf"] = [{**kept, "type": next(kind for kind in kept["type"] if kind != "null")}, absent]
    elif {"type": "null"} in node.get("anyOf", ()):
        node["anyOf"] = [absent if option == {"type": "null"} else option for option in node["anyOf"]]


def _with_files(schema: Node) -> Node:
    """Return the schema of sweeps, in which a file may replace a table."""
    changed = copy.deepcopy(schema)
    path = {"type": "string", "format": "path"}
    instead = {"type": "object", "properties": {"file": path}, "required": ["file"], "additionalProperties": False}
    properties = changed["$defs"]["Spec"]["properties"]
    properties["axis"]["items"] = {"anyOf": [properties["axis"]["items"], instead]}
    properties["perturbation"]["anyOf"] = [{"$ref": properties["perturbation"].pop("$ref")}, instead]
    return changed


def _nodes(node: Any) -> Iterator[Node]:
    """Yield every table of a schema."""
    if isinstance(node, dict):
        yield node
        node = list(node.values())
    if isinstance(node, list):
        for entry in node:
            yield from _nodes(entry)


def _prose(text: str) -> str:
    """Return a description on one line, as plain text without code."""
    text = re.sub(r"\[(`[^`]*`)\]", r"\1", " ".join(text.partition("```")[0].split())).replace("`Self::", "`")
    return re.sub(r"\\([][])", r"\1", text)


# --- the page ----------------------------------------------------------------------------------------------------

INTRODUCTION = """# Configuration reference

Every key of a flight's and of a robot's TOML files. Whatever is not here is refused with the key, its value and what
was expected. This page is made from the crate's types.

Any table of a flight may name another file as its `base`: that file's table is read first, and the keys beside `base`
are laid over it, table by table; a table of another kind (another `profile`, `model` or `dynamics`) replaces it whole.
A key whose default is none is removed by `false`, as in `sensors = false`.
Paths start at the file that names them. Keys without a default are required.

The first line of a file, such as `#:schema ../schema/experiments.schema.json`, names its schema, so that an editor
with [Taplo](https://taplo.tamasfe.dev) (in VS Code: *Even Better TOML*) completes keys and marks mistakes. Sweeps,
studies and trainings have schemas in `configs/schema/` too.
"""

COLUMNS = "| key | type | unit | default | range | meaning |\n|---|---|---|---|---|---|\n"


def reference(schemas: Mapping[str, Node]) -> str:
    """Return the page of all keys."""
    parts = [INTRODUCTION]
    for root, heading in {"experiments": "A flight", "robot": "A robot"}.items():
        schema = schemas[root]
        tables = {**schema.get("$defs", {}), "": schema}
        parts.append(f"\n## {heading}: `configs/{root}/*.toml`\n")
        for name, keys in _places(tables).items():
            if name:
                parts.append(f"\n### {', '.join(f'`{key}`' for key in keys)} {{#{name}}}\n")
            parts += _section(tables[name], tables)
    return "".join(parts)


def _places(tables: Mapping[str, Node]) -> dict[str, list[str]]:
    """Return the tables below that without a name, each with the dotted keys at which it occurs."""
    keys_of: dict[str, list[str]] = {"": [""]}

    def walk(node: Node, key: str) -> None:
        node = _given(node)
        if (name := name_of(node)) and not choices_of(tables[name]):
            known = keys_of.setdefault(name, [])
            if key not in known:
                known.append(key)
                walk_inside(tables[name], key)
        elif node.get("type") == "array":
            walk(items(node), f"{key}[]")
        elif isinstance(node.get("additionalProperties"), dict):
            walk(node["additionalProperties"], f"{key}.NAME")

    def walk_inside(node: Node, key: str) -> None:
        for _, _, kind in kinds(node):
            for name, inner in kind.get("properties", {}).items():
                walk(inner, f"{key}.{name}".lstrip("."))

    walk_inside(tables[""], "")
    return keys_of


def _given(node: Node) -> Node:
    """Return a node without the null of a key that may be absent."""
    if isinstance(node.get("type"), list):
        return {**node, "type": node["type"][0]}
    if "anyOf" in node:
        there = next(option for option in node["anyOf"] if option.get("type") != "null")
        return {**there, **{key: node[key] for key in ("description", "default") if key in node}}
    return node


def name_of(node: Node) -> str:
    """Return the name of the table or of the choices that a node refers to, if any."""
    return str(node.get("$ref", "")).removeprefix("#/$defs/")


def choices_of(node: Node) -> dict[str, str]:
    """Return the names allowed at a node, with their meaning."""
    named = {option["const"]: option.get("description", "") for option in node.get("oneOf", ()) if "const" in option}
    return named or dict.fromkeys(node.get("enum", ()), "")


def kinds(node: Node) -> Iterator[tuple[str, str, Node]]:
    """Yield the kinds of a table, each with the key and value that distinguish it; a table of one kind has none."""
    for kind in node.get("oneOf", [node]):
        constants = ((key, part["const"]) for key, part in kind.get("properties", {}).items() if "const" in part)
        yield *next(constants, ("", "")), kind


def items(node: Node) -> Node:
    """Return the schema of the entries of a list."""
    entries: Node = node.get("items") or node["prefixItems"][0]
    return entries


def _section(node: Node, tables: Mapping[str, Node]) -> Iterator[str]:
    yield f"\n{_markdown(node.get('description', ''))[0]}\n"
    for tag, value, kind in kinds(node):
        keys = {key: part for key, part in kind.get("properties", {}).items() if "const" not in part}
        if tag:
            yield f'\n`{tag} = "{value}"`: {_prose(kind.get("description", ""))}\n'
        if keys:
            yield f"\n{COLUMNS}"
        elif not tag:
            yield "\nA table without keys.\n"
        for key, part in keys.items():
            yield _row(key, part, key in kind.get("required", ()), tables)


def _row(key: str, node: Node, required: bool, tables: Mapping[str, Node]) -> str:
    meaning, unit = _markdown(node.get("description", ""))
    kind, limits, choices = _kind(_given(node), tables)
    default = node.get("default")
    if isinstance(default, dict):
        written = "its own" if name_of(_given(node)) else "none"
    else:
        written = "" if required else "none" if default is None else f"`{json.dumps(default, ensure_ascii=False)}`"
    listed = "; ".join(f"`{name}`: {_prose(text).rstrip('.')}" for name, text in choices.items() if text)
    meaning = " ".join(part for part in (meaning, f"{listed}." if listed else "") if part)
    cells = [f"`{key}`", kind, unit, written, limits, meaning]
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |\n"


def _kind(node: Node, tables: Mapping[str, Node]) -> tuple[str, str, dict[str, str]]:
    """Return type and range of a node in words, and its choices with their meaning."""
    if name := name_of(node):
        choices = choices_of(tables[name])
        return " or ".join(f"`{choice}`" for choice in choices) or f"[table](#{name})", "", choices
    if node["type"] == "array":
        inner, limits, choices = _kind(items(node), tables)
        length = node.get("minItems")
        is_fixed = length is not None and length == node.get("maxItems")
        return f"list of {f'{length}: ' if is_fixed else ''}{inner}", limits, choices
    if node["type"] == "object":
        inner, limits, choices = _kind(node["additionalProperties"], tables)
        return f"by name: {inner}", limits, choices
    words = {"string": "path" if node.get("format") == "path" else "text", "boolean": "true or false"}
    signs = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<"}
    limits = ", ".join(f"{sign} {node[name]:g}" for name, sign in signs.items() if name in node)
    return words.get(node["type"], str(node["type"])), limits, {}


def _markdown(text: str) -> tuple[str, str]:
    """Return a description without its first unit, and that unit."""
    unit = re.search(r" \\\[([^]\\]*)\\\]", text)
    return (_prose(text.replace(unit[0], "", 1)), unit[1]) if unit else (_prose(text), "")
