"""Arrays have the shapes that functions and structures state."""

import ast
import os
import subprocess
import sys

import pytest

from jax_aero.base.places import HOME

KINDS = {"Bool", "Float", "Int", "Key", "Shaped"}


def test_public_functions_and_structures_state_the_shapes_of_their_arrays():
    bare = []
    for path in sorted((HOME / "jax_aero").rglob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        if _imports_array(tree):
            bare += [f"{path.relative_to(HOME)}:{hint.lineno}" for hint in _hints(tree) if _is_bare(hint)]
    assert bare == []


def _imports_array(tree):
    found = (node for node in tree.body if isinstance(node, ast.ImportFrom) and node.module == "jax_aero.types")
    return any(name.name == "Array" for node in found for name in node.names)


def _hints(scope):
    """Annotations of public functions, methods and fields."""
    for node in scope.body:
        if isinstance(node, ast.AnnAssign):
            yield node.annotation
        elif isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            yield from _hints(node)
        elif isinstance(node, ast.FunctionDef) and not node.name.startswith("_"):
            arguments = (node.args.posonlyargs, node.args.args, node.args.kwonlyargs)
            hints = [argument.annotation for some in arguments for argument in some]
            yield from (hint for hint in (*hints, node.returns) if hint is not None)


def _is_bare(hint):
    """Whether an annotation names an array outside of `Float[Array, "..."]` and its like."""
    if isinstance(hint, ast.Subscript) and isinstance(hint.value, ast.Name) and hint.value.id in KINDS:
        return False
    return getattr(hint, "id", None) == "Array" or any(_is_bare(part) for part in ast.iter_child_nodes(hint))


@pytest.mark.slow
def test_the_shapes_hold_where_flights_and_aerodynamic_models_are_traced():
    options = {"JAX_ENABLE_X64": "1", "JAX_PLATFORMS": "cpu", "JAX_DISABLE_MOST_OPTIMIZATIONS": "1"}
    done = subprocess.run(
        [sys.executable, "-m", "tests.tools.traced"],
        cwd=HOME,
        env=os.environ | options,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
