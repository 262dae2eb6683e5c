"""`_core.pyi` declares exactly what the compiled module has."""

import ast
import importlib
import inspect
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
STUB = ast.parse((ROOT / "jax_aero" / "_core.pyi").read_text(encoding="utf-8"))
CORE = importlib.import_module("jax_aero._core")


def public_names(names) -> set[str]:
    return {name for name in names if not name.startswith("_") or name == "__version__"}


def stub_names(body) -> set[str]:
    names = set()
    for node in body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.add(node.name)
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            names.add(node.target.id)
    return public_names(names)


def stub_nodes(kind):
    return [node for node in STUB.body if isinstance(node, kind) and not node.name.startswith("_")]


def test_the_stub_has_the_names_of_the_module():
    assert stub_names(STUB.body) == public_names(vars(CORE))


@pytest.mark.parametrize("node", stub_nodes(ast.ClassDef), ids=lambda node: node.name)
def test_each_class_has_the_members_of_the_stub(node):
    assert stub_names(node.body) == public_names(vars(getattr(CORE, node.name)))


@pytest.mark.parametrize("node", stub_nodes(ast.FunctionDef), ids=lambda node: node.name)
def test_each_function_has_the_parameters_of_the_stub(node):
    arguments = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
    assert [argument.arg for argument in arguments] == list(inspect.signature(getattr(CORE, node.name)).parameters)
