"""Modules use one another in one direction: neither the crates nor the packages have a cycle of modules.

A module of a crate that passes names on (`pub use`) is looked through: who takes such a name uses the module that
defines it.
"""

from __future__ import annotations

import re
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

Graph = dict[str, set[str]]


def cycle(graph: Graph) -> list[str]:
    """Return the modules of a cycle; none if there is no cycle."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return list(error.args[1])
    return []


# --- Rust ---------------------------------------------------------------------------------------------------------


def rust_code(path: Path) -> str:
    """Return a file without comments, strings and its module of tests."""
    text = re.sub(r"//[^\n]*", "", path.read_text())
    text = re.sub(r'"(?:[^"\\]|\\.)*"', '""', text)
    return text.split("#[cfg(test)]\nmod ")[0]


def expand(tree: str) -> list[str]:
    """Return the paths of a `use`: `a::{b, c::d as e}` is `a::b` and `a::c::d`."""
    head, brace, rest = tree.strip().partition("{")
    if not brace:
        return [head.split(" as ")[0].strip()] if head.strip() else []
    parts, depth, start = [], 0, 0
    inner = rest.rsplit("}", 1)[0] + ","
    for place, letter in enumerate(inner):
        depth += (letter == "{") - (letter == "}")
        if letter == "," and depth == 0:
            parts.append(inner[start:place])
            start = place + 1
    return [head + path for part in parts for path in expand(part)]


class Crate:
    """Modules of a crate, named by their paths: `control::measure::channels`; the root is the empty name."""

    def __init__(self, source: Path) -> None:
        files = {path.relative_to(source).with_suffix("").as_posix(): path for path in source.rglob("*.rs")}
        self.code = {name.replace("/", "::").removesuffix("lib"): rust_code(path) for name, path in files.items()}
        self.passed: dict[str, dict[str, str]] = {name: {} for name in self.code}
        uses = re.compile(r"^[ \t]*(pub(?:\([^)]*\))? )?use ([^;]+);", re.MULTILINE)
        self.used: dict[str, list[str]] = {}
        for name, code in self.code.items():
            rest = uses.sub("", code)
            self.used[name] = re.findall(r"\b(?:crate|super|self)(?:::\w+)+", rest)
            self.used[name] += [f"{path}" for path in re.findall(r"(?<![\w:])[a-z_]\w*(?:::\w+)+", rest)]
            for is_public, tree in uses.findall(code):
                for path in expand(" ".join(tree.split())):
                    item = path.split("::")[-1]
                    if is_public:
                        self.passed[name][item] = path
                    if not is_public or re.search(rf"\b{item}\b", rest):
                        self.used[name].append(path)

    def owner(self, module: str, path: str) -> str | None:
        """Return the module that defines what a path names within `module`; `None` outside the crate."""
        first, *rest = path.split("::")
        place = module
        if first == "crate":
            place = ""
        elif first == "super":
            place = module.rpartition("::")[0]
        elif first != "self":
            if self.child(module, first) is None:
                return None
            rest = [first, *rest]
        while rest:
            if rest[0] == "super":
                place, rest = place.rpartition("::")[0], rest[1:]
            elif (child := self.child(place, rest[0])) is not None:
                place, rest = child, rest[1:]
            elif rest[0] in self.passed[place]:
                return self.owner(place, "::".join([self.passed[place][rest[0]], *rest[1:]]))
            else:
                break
        return place

    def child(self, module: str, name: str) -> str | None:
        """Return a module within `module`, if it has one of this name."""
        found = f"{module}::{name}" if module else name
        return found if found in self.code else None

    def graph(self) -> Graph:
        """Return which modules each module uses."""
        owners = {name: {self.owner(name, path) for path in paths} for name, paths in self.used.items()}
        return {name: {owner for owner in found if owner is not None} - {name} for name, found in owners.items()}


@pytest.mark.parametrize("crate", ["core", "io", "sim"])
def test_modules_of_a_crate_have_no_cycle(crate):
    assert cycle(Crate(ROOT / "rust" / crate / "src").graph()) == []


def test_a_cycle_of_a_crate_is_found_through_names_that_are_passed_on(tmp_path):
    source = {
        "lib.rs": "pub mod a;\npub mod b;\n",
        "a.rs": "mod inner;\npub use inner::Thing;\nuse crate::b::{self, Other};\n",
        "a/inner.rs": "pub struct Thing;\n",
        "b.rs": "// use crate::a::Nothing;\nuse crate::{a::Thing};\npub struct Other;\n",
    }
    (tmp_path / "a").mkdir()
    for name, text in source.items():
        (tmp_path / name).write_text(text)
    assert Crate(tmp_path).graph() == {"": set(), "a": {"b"}, "a::inner": set(), "b": {"a::inner"}}
    assert cycle(Crate(tmp_path).graph()) == []
    (tmp_path / "a" / "inner.rs").write_text("use super::super::b::Other;\n")
    assert set(cycle(Crate(tmp_path).graph())) == {"a::inner", "b"}


# --- Python -------------------------------------------------------------------------------------------------------


def test_modules_of_the_packages_have_no_cycle():
    grimp = pytest.importorskip("grimp", reason="import-linter is not installed: make setup")
    packages = ("jax_aero", "experiments", "paper_figs")
    imports = grimp.build_graph(*packages, exclude_type_checking_imports=True, cache_dir=None)
    graph = {module: imports.find_modules_directly_imported_by(module) for module in imports.modules}
    assert len(graph) > 200
    assert cycle(graph) == []
