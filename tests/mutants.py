"""Changes the program in one place at a time, and looks whether the tests of that place notice.

    python tests/mutants.py jax_aero experiments --count 150 --seed 1 --seconds 3000

Each mutant is drawn from the seed and its number, so a run goes on where another ended (`--first`). Its module is
compiled from the changed syntax tree while it is imported: no file is written, and other programs see nothing of it.
The tests of a module are the files of `tests/` that import it; where none does, those that import what imports it.
A mutant that survives the first few is tried again with `--first NUMBER --count 1 --files 99`. One that survives all of
them has no test that fails: `mutants.md` beside this file says of each known one why it may.
"""

from __future__ import annotations

import argparse
import ast
import importlib.abc
import importlib.machinery
import os
import random
import signal
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = ("units", "parity", "gradients", "train", "view")

SWAPPED: dict[type, type] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.Pow: ast.Mult,
    ast.FloorDiv: ast.Mult, ast.Mod: ast.Mult, ast.BitOr: ast.BitAnd, ast.BitAnd: ast.BitOr,
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In, ast.And: ast.Or, ast.Or: ast.And,
}  # fmt: skip


class Mutation(ast.NodeTransformer):
    """Counts the places that can be changed, and changes the one of this number."""

    def __init__(self, place: int | None = None) -> None:
        self.place, self.count, self.what = place, 0, ""

    def _is_here(self, node: ast.AST, what: str) -> bool:
        here = self.count == self.place
        self.count += 1
        if here:
            self.what = f"line {getattr(node, 'lineno', 0)}: {what}"
        return here

    def _swap(self, node: Any, operator: Any) -> Any:
        other = SWAPPED.get(type(operator))
        if other and self._is_here(
            node, f"{type(operator).__name__} becomes {other.__name__} in `{ast.unparse(node)}`"
        ):
            return other()
        return operator

    def visit_BinOp(self, node: ast.BinOp) -> ast.AST:
        self.generic_visit(node)
        node.op = self._swap(node, node.op)
        return node

    def visit_BoolOp(self, node: ast.BoolOp) -> ast.AST:
        self.generic_visit(node)
        node.op = self._swap(node, node.op)
        return node

    def visit_Compare(self, node: ast.Compare) -> ast.AST:
        self.generic_visit(node)
        node.ops = [self._swap(node, operator) for operator in node.ops]
        return node

    def visit_UnaryOp(self, node: ast.UnaryOp) -> ast.AST:
        self.generic_visit(node)
        if isinstance(node.op, ast.USub | ast.Not) and self._is_here(node, f"`{ast.unparse(node)}` without its sign"):
            return node.operand
        return node

    def visit_Constant(self, node: ast.Constant) -> ast.AST:
        value = node.value
        if isinstance(value, bool):
            return ast.Constant(not value) if self._is_here(node, f"{value} negated") else node
        if isinstance(value, int | float) and self._is_here(node, f"{value} becomes {value + 1}"):
            return ast.Constant(value + 1)
        return node

    def visit_Expr(self, node: ast.Expr) -> ast.AST:
        # Docstrings stay.
        if isinstance(node.value, ast.Call) and self._is_here(node, f"without `{ast.unparse(node)}`"):
            return ast.Pass()
        return self.generic_visit(node) if not isinstance(node.value, ast.Constant) else node

    def visit_AugAssign(self, node: ast.AugAssign) -> ast.AST:
        self.generic_visit(node)
        return ast.Pass() if self._is_here(node, f"without `{ast.unparse(node)}`") else node

    def visit_Raise(self, node: ast.Raise) -> ast.AST:
        return ast.Pass() if self._is_here(node, f"without `{ast.unparse(node)}`") else node

    def visit_AnnAssign(self, node: ast.AnnAssign) -> ast.AST:
        if node.value is not None:
            node.value = self.visit(node.value)
        return node

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        # Neither annotations nor decorators.
        node.body = [self.visit(statement) for statement in node.body]
        node.args.defaults = [self.visit(default) for default in node.args.defaults]
        return node


def module_of(path: Path) -> str:
    """Return the dotted name of a file of the project."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imported(path: Path) -> set[str]:
    """Return the modules that a file names in its imports."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            found |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def tests_of(module: str, sources: Sequence[Path], most: int) -> list[Path]:
    """Return the test files that import a module, or else those that import what imports it: its namesake first."""
    tests = {path: imported(path) for folder in FOLDERS for path in (ROOT / "tests" / folder).glob("test_*.py")}
    sought, known = {module}, {module_of(path): imported(path) for path in sources}
    while True:
        if found := [path for path, names in tests.items() if names & sought]:
            name = module.rsplit(".", 1)[-1]
            return sorted(found, key=lambda path: (name not in path.stem, path.stat().st_size))[:most]
        wider = sought | {name for name, names in known.items() if names & sought}
        if wider == sought:
            return []
        sought = wider


class Importer(importlib.abc.MetaPathFinder):
    """Compiles one module from its changed syntax tree."""

    def __init__(self, path: Path, place: int) -> None:
        self.path, self.name, self.place = path, module_of(path), place

    def find_spec(self, name: str, path: Any, _target: Any = None) -> Any:
        if name != self.name:
            return None
        spec = importlib.machinery.PathFinder.find_spec(name, path)
        source, place = self.path.read_text(encoding="utf-8"), self.place

        class Loader(importlib.machinery.SourceFileLoader):
            def get_code(self, _fullname: str) -> Any:
                tree = ast.fix_missing_locations(Mutation(place).visit(ast.parse(source)))
                return compile(tree, self.path, "exec")

        assert spec is not None
        spec.loader = Loader(name, str(self.path))
        return spec


def run(path: Path, place: int, tests: Sequence[Path], limit: float) -> str:
    """Run tests in a child of this process; say `killed`, `timeout` or `survived`."""
    if (child := os.fork()) == 0:
        sys.meta_path.insert(0, Importer(path, place))
        try:
            import pytest

            with Path(os.devnull).open("w") as nothing, redirect_stdout(nothing), redirect_stderr(nothing):
                code = pytest.main(["-q", "-x", "-p", "no:cacheprovider", *map(str, tests)])
        except BaseException:  # whatever it is, it was noticed
            code = 1
        os._exit(int(code))
    end = time.monotonic() + limit
    while time.monotonic() < end:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return "survived" if os.waitstatus_to_exitcode(status) == 0 else "killed"
        time.sleep(0.1)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return "timeout"


def draw(sources: Sequence[Path], seed: int, first: int) -> Iterator[tuple[int, Path, int, str]]:
    """Yield number, file, place and description of mutants, each place equally likely."""
    counts = []
    for path in sources:
        mutation = Mutation()
        mutation.visit(ast.parse(path.read_text(encoding="utf-8")))
        counts.append(mutation.count)
    for number in range(first, sys.maxsize):
        drawn = random.Random(f"{seed} {number}")
        path, count = drawn.choices(list(zip(sources, counts, strict=True)), counts)[0]
        mutation = Mutation(drawn.randrange(count))
        mutation.visit(ast.parse(path.read_text(encoding="utf-8")))
        yield number, path, mutation.place or 0, mutation.what


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("packages", nargs="+", help="folders or files")
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--first", type=int, default=0, help="number of the first mutant")
    parser.add_argument("--seconds", type=float, default=1e9, help="time after which no other mutant is begun")
    parser.add_argument("--files", type=int, default=3, help="most test files that are run for a mutant")
    parser.add_argument("--limit", type=float, default=300.0, help="longest time of one mutant's tests [s]")
    given = parser.parse_args()
    os.chdir(ROOT)
    sys.path.insert(0, str(ROOT))
    # Their children need not import them again.
    import jax  # noqa: F401
    import numpy  # noqa: F401
    import pytest  # noqa: F401
    import xarray  # noqa: F401

    everything = sorted(path for name in ("jax_aero", "experiments") for path in (ROOT / name).rglob("*.py"))
    chosen = [ROOT / name for name in given.packages]
    sources = [path for path in everything if any(path == one or one in path.parents for one in chosen)]
    begun, verdicts = time.monotonic(), dict.fromkeys(("killed", "survived", "timeout", "untested"), 0)
    for number, path, place, what in draw(sources, given.seed, given.first):
        if number >= given.first + given.count or time.monotonic() - begun > given.seconds:
            break
        tests = tests_of(module_of(path), everything, given.files)
        verdict = run(path, place, tests, given.limit) if tests else "untested"
        verdicts[verdict] += 1
        print(f"{number} {verdict}: {path.relative_to(ROOT)} {what}", flush=True)
    print(verdicts)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
