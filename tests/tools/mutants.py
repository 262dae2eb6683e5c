"""Changes the program in one place at a time, and looks whether the tests of that place notice.

    python tests/tools/mutants.py --record units train
    python tests/tools/mutants.py jax_aero experiments --count 150 --seed 1 --seconds 3000

The first command runs test files of folders of `tests/` once and writes to `target/mutants.json` which statements each
test executes, and how long it takes; after a change of the modules it is run again. The second tries mutants with the
tests that execute the changed statement, the quick ones first. A constant of a module or of a class is tried with the
tests that execute anything of that module, or else of the modules that import it.

Each mutant is drawn from the seed and its number, so a run goes on where another ended (`--first`). Its module is
compiled from the changed syntax tree while it is imported: no file is written, and other programs see nothing of it,
not even processes that the tests start. A mutant that survives the first few test files is tried again with
`--first NUMBER --count 1 --files 99 --whole`. One that survives all of them has no test that fails: `mutants.md` beside
this file says of each known one why it may.
"""

from __future__ import annotations

import argparse
import ast
import builtins
import functools
import importlib.abc
import importlib.machinery
import json
import os
import random
import signal
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
RECORD = ROOT / "target" / "mutants.json"

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
        self.statement: int | None = None
        """Line of the statement that is visited, in a function."""
        self.line: int | None = None
        """Line of the changed statement, or None outside of functions."""
        self._depth = 0

    def visit(self, node: ast.AST) -> Any:
        before = self.statement
        if self._depth and isinstance(node, ast.stmt):
            self.statement = node.lineno
        visited = super().visit(node)
        self.statement = before
        return visited

    def _is_here(self, node: ast.AST, what: str) -> bool:
        here = self.count == self.place
        self.count += 1
        if here:
            self.line = self.statement
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
        self._depth += 1
        node.body = [self.visit(statement) for statement in node.body]
        self._depth -= 1
        node.args.defaults = [self.visit(default) for default in node.args.defaults]
        return node


class Marks(ast.NodeTransformer):
    """Puts a mark before each statement of a function; the first string of a body stays first."""

    def __init__(self, file: str) -> None:
        self.file, self.depth = file, 0

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        self.depth += 1
        marked = self.generic_visit(node)
        self.depth -= 1
        return marked

    def generic_visit(self, node: ast.AST) -> ast.AST:
        super().generic_visit(node)
        for name in ("body", "orelse", "finalbody") if self.depth else ():
            if isinstance(statements := getattr(node, name, None), list):
                setattr(node, name, [part for statement in statements for part in self._mark(statement)])
        return node

    def _mark(self, statement: ast.stmt) -> list[ast.stmt]:
        if isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant):
            return [statement]
        return [*ast.parse(f"__seen__.add(({self.file!r}, {statement.lineno}))").body, statement]


def module_of(path: Path) -> str:
    """Return the dotted name of a file of the project."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@functools.cache
def find_imports(path: Path) -> set[str]:
    """Return the modules that a file names in its imports."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            found |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return found


class Importer(importlib.abc.MetaPathFinder):
    """Compiles modules from their changed syntax trees."""

    def __init__(self, sources: Sequence[Path], change: Callable[[str], ast.NodeTransformer]) -> None:
        self.sources, self.change = {module_of(path): path for path in sources}, change

    def find_spec(self, name: str, path: Any, _target: Any = None) -> Any:
        if name not in self.sources:
            return None
        spec, file, change = importlib.machinery.PathFinder.find_spec(name, path), self.sources[name], self.change

        class Loader(importlib.machinery.SourceFileLoader):
            def get_code(self, _fullname: str) -> Any:
                tree = change(str(file.relative_to(ROOT))).visit(ast.parse(file.read_text(encoding="utf-8")))
                return compile(ast.fix_missing_locations(tree), self.path, "exec")

        assert spec is not None
        spec.loader = Loader(name, str(file))
        return spec


class Recorder:
    """Notes which statements each test and each of its fixtures executes, and their time."""

    def __init__(self) -> None:
        self.tests: dict[str, Any] = {}
        self.failed: set[str] = set()
        self.fixtures: dict[Any, tuple[set[tuple[str, int]], float]] = {}
        self.seen: set[tuple[str, int]] = set()
        self.in_fixtures = 0.0
        builtins.__seen__ = self.seen  # type: ignore[attr-defined]

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: Any) -> Any:
        before, begun = set(self.seen), time.monotonic()
        self.seen.clear()
        try:
            return (yield)
        finally:
            self.fixtures[fixturedef] = set(self.seen), time.monotonic() - begun
            self.in_fixtures += time.monotonic() - begun
            self.seen |= before

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: Any) -> Any:
        self.seen.clear()
        self.in_fixtures, begun = 0.0, time.monotonic()
        yield
        lines, seconds = set(self.seen), time.monotonic() - begun - self.in_fixtures
        for definitions in item._fixtureinfo.name2fixturedefs.values():
            for definition in definitions:
                ran, took = self.fixtures.get(definition, (set(), 0.0))
                lines, seconds = lines | ran, seconds + took
        files: dict[str, list[int]] = {}
        for file, line in sorted(lines):
            files.setdefault(file, []).append(line)
        # A test that fails without any change notices nothing.
        if item.nodeid not in self.failed:
            self.tests[item.nodeid] = {"seconds": round(seconds, 3), "lines": files}
        return True

    def pytest_runtest_logreport(self, report: Any) -> None:
        if report.failed:
            self.failed.add(report.nodeid)


class Chosen:
    """Runs only some tests, in this order."""

    def __init__(self, tests: Sequence[str]) -> None:
        self.ranks = {test: rank for rank, test in enumerate(tests)}

    def pytest_collection_modifyitems(self, items: list[Any]) -> None:
        items[:] = sorted(
            (item for item in items if item.nodeid in self.ranks), key=lambda item: self.ranks[item.nodeid]
        )


def run_in_child(work: Callable[[], int], limit: float) -> int | None:
    """Return the exit status of a child of this process that does something, or None if it takes too long."""
    if (child := os.fork()) == 0:
        try:
            with Path(os.devnull).open("w") as nothing, redirect_stdout(nothing), redirect_stderr(nothing):
                code = work()
        except BaseException:  # whatever it is, it was noticed
            code = 1
        os._exit(code)
    end = time.monotonic() + limit
    while time.monotonic() < end:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.05)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return None


def run_tests(files: Sequence[str], plugin: object, *options: str) -> int:
    """Run test files with a plugin."""
    return int(pytest.main(["-q", "-p", "no:cacheprovider", *options, *files], plugins=[plugin]))


def record(sources: Sequence[Path], tests: Sequence[Path], limit: float) -> None:
    """Run test files once each, and write which statements each of their tests executes."""

    def work(name: str) -> int:
        sys.meta_path.insert(0, Importer(sources, Marks))
        recorder = Recorder()
        run_tests([name], recorder)
        known = json.loads(RECORD.read_text()) if RECORD.is_file() else {}
        kept = {test: of for test, of in known.items() if test.split("::")[0] != name}
        RECORD.write_text(json.dumps(kept | recorder.tests))
        return 0

    RECORD.parent.mkdir(exist_ok=True)
    for path in tests:
        name, begun = str(path.relative_to(ROOT)), time.monotonic()
        answer = run_in_child(functools.partial(work, name), limit)
        print(f"{name}: {time.monotonic() - begun:.0f} s{'' if answer == 0 else ', not recorded'}", flush=True)


def tests_of(
    path: Path, line: int | None, known: Mapping[str, Any], sources: Sequence[Path], most: int, whole: bool
) -> list[str]:
    """Return the tests that execute a statement, file by file: the namesake of the module first, then the quickest."""
    files = {module_of(source): str(source.relative_to(ROOT)) for source in sources}
    sought, imports = {module_of(path)}, {module_of(source): find_imports(source) for source in sources}
    while True:
        names = {files[name] for name in sought}
        if line is None:
            found = [test for test, of in known.items() if names & set(of["lines"])]
        else:
            found = [test for test, of in known.items() if line in of["lines"].get(files[module_of(path)], ())]
        wider = sought | {name for name, of in imports.items() if of & sought}
        if found or line is not None or wider == sought:
            break
        sought = wider
    by_file: dict[str, list[str]] = {}
    for test in sorted(found, key=lambda test: known[test]["seconds"]):
        by_file.setdefault(test.split("::")[0], []).append(test)
    ranked = sorted(by_file, key=lambda file: (path.stem not in file, known[by_file[file][0]]["seconds"]))[:most]
    if whole:
        return [test for test in known if test.split("::")[0] in ranked]
    return [test for file in ranked for test in by_file[file]]


def run(path: Path, place: int, tests: Sequence[str], limit: float) -> str:
    """Run tests of a mutant; say `killed`, `timeout`, `survived` or, if they are no longer there, `untested`."""

    def work() -> int:
        sys.meta_path.insert(0, Importer([path], lambda _file: Mutation(place)))
        return run_tests(list(dict.fromkeys(test.split("::")[0] for test in tests)), Chosen(tests), "-x")

    answer = run_in_child(work, limit)
    return {None: "timeout", 0: "survived", int(pytest.ExitCode.NO_TESTS_COLLECTED): "untested"}.get(answer, "killed")


def draw(sources: Sequence[Path], seed: int, first: int) -> Iterator[tuple[int, Path, int, int | None, str]]:
    """Yield number, file, place, line of the statement and description of mutants, each place equally likely."""
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
        yield number, path, mutation.place or 0, mutation.line, mutation.what


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("packages", nargs="*", help="folders or files")
    parser.add_argument("--record", nargs="+", metavar="FOLDER", help="folders or files of `tests/` to record")
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--first", type=int, default=0, help="number of the first mutant")
    parser.add_argument("--seconds", type=float, default=1e9, help="time after which no other mutant is begun")
    parser.add_argument("--files", type=int, default=3, help="most test files that are run for a mutant")
    parser.add_argument("--limit", type=float, default=300.0, help="longest time of one mutant's tests [s]")
    parser.add_argument("--whole", action="store_true", help="run the test files whole")
    given = parser.parse_args()
    os.chdir(ROOT)
    sys.path.insert(0, str(ROOT))
    # Their children need not import them again.
    for name in (
        "casadi",
        "h5netcdf",
        "jax",
        "matplotlib.pyplot",
        "mujoco",
        "optuna",
        "pandas",
        "scipy.optimize",
        "xarray",
    ):
        importlib.import_module(name)

    everything = sorted(path for name in ("jax_aero", "experiments") for path in (ROOT / name).rglob("*.py"))
    if given.record:
        folders = [ROOT / "tests" / name for name in given.record]
        record(
            everything,
            sorted(path for one in folders for path in ([one] if one.is_file() else one.rglob("test_*.py"))),
            given.limit,
        )
    if not given.packages:
        return 0
    if not RECORD.is_file():
        parser.error(f"there is no {RECORD}; make it with --record units train")
    known = json.loads(RECORD.read_text())
    chosen = [ROOT / name for name in given.packages]
    sources = [path for path in everything if any(path == one or one in path.parents for one in chosen)]
    begun, verdicts = time.monotonic(), dict.fromkeys(("killed", "survived", "timeout", "untested"), 0)
    for number, path, place, line, what in draw(sources, given.seed, given.first):
        if number >= given.first + given.count or time.monotonic() - begun > given.seconds:
            break
        tests = tests_of(path, line, known, everything, given.files, given.whole)
        verdict = run(path, place, tests, given.limit) if tests else "untested"
        verdicts[verdict] += 1
        print(f"{number} {verdict}: {path.relative_to(ROOT)} {what}", flush=True)
    print(verdicts)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
