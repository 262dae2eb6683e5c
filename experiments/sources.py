"""Hashes of the code and of the files that determine a result, equal on every machine.

Code comprises the imported modules, the compiled crate, and the versions of packages. Imports are followed from file to
file without executing them, so that the hash does not depend on what a process has loaded.
"""

from __future__ import annotations

import ast
import functools
import hashlib
import importlib.machinery
import importlib.metadata
import sys
from collections.abc import Iterator
from pathlib import Path

import jax_aero
from jax_aero.base.named import named_files
from jax_aero.base.terminal import Refused

FOLDERS = {"jax_aero": Path(jax_aero.__file__).parent, "experiments": Path(__file__).parent}
"""Packages whose imports are followed."""

COMPILED = "jax_aero._core"

NUMERICAL = ("casadi", "jax", "mujoco", "numpy", "pyarrow", "scipy")
"""Packages whose version counts if they are imported."""


@functools.cache
def code_hash(*roots: str) -> str:
    """Return a hash of some modules and of all that they import; results with different hashes must not be mixed.

    Raises
    ------
    Refused
        If the crate is not compiled.
    """
    files, packages = closure(*roots)
    if COMPILED not in files:
        raise Refused(f"the compiled module {COMPILED} is not here; `make setup` builds it")
    total = hashlib.sha256()
    for name in sorted(files):
        total.update(name.encode() + hashlib.sha256(files[name].read_bytes()).digest())
    for name in sorted(packages):
        total.update(f"{name} {importlib.metadata.version(name)}".encode())
    return total.hexdigest()[:16]


def closure(*roots: str) -> tuple[dict[str, Path], set[str]]:
    """Return, for some modules and all that they import, the files by module, and the packages that count."""
    files: dict[str, Path] = {}
    packages: set[str] = set()
    # A module started with `python -m` is called `__main__`.
    started = sys.modules["__main__"].__spec__
    waiting = [started.name if root == "__main__" and started else root for root in roots]
    while waiting:
        name = waiting.pop()
        top, _, rest = name.partition(".")
        packages |= {top} & set(NUMERICAL)
        if top not in FOLDERS or name in files or (path := _file(FOLDERS[top], rest)) is None:
            continue
        files[name] = path
        waiting += [name.rpartition(".")[0]] if rest else []
        waiting += _imports(path) if path.suffix == ".py" else []
    return files, packages


def _file(folder: Path, rest: str) -> Path | None:
    base = folder.joinpath(*rest.split(".")) if rest else folder
    names = [base / "__init__.py", *(base.with_name(base.name + end) for end in importlib.machinery.all_suffixes())]
    return next((path for path in names if path.is_file()), None)


def _imports(path: Path) -> Iterator[str]:
    nodes: list[ast.AST] = [ast.parse(path.read_bytes())]
    while nodes:
        match nodes.pop():
            case ast.Import(names):
                yield from (alias.name for alias in names)
            case ast.ImportFrom(str(module), names):
                yield module
                yield from (f"{module}.{alias.name}" for alias in names)
            case ast.If(ast.Name("TYPE_CHECKING"), _, otherwise):
                nodes += otherwise
            case ast.stmt() | ast.Module() | ast.ExceptHandler() | ast.match_case() as node:
                nodes += ast.iter_child_nodes(node)


def file_hash(path: Path) -> str:
    """Return a hash of a file and, recursively, of every file that it names, wherever they are."""
    total = hashlib.sha256()
    for file in named_files(path):
        total.update(hashlib.sha256(file.read_bytes()).digest())
    return total.hexdigest()
