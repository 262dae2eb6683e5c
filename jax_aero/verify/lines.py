"""What of JAX's model no comparison executes: lines of its Python, and sides of its choices.

A line runs while a program is traced, whichever way its choices go later; so each choice (`where`, `cond`, `switch`)
of a compiled program counts whether it has gone one way and the other.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import Literal

import jax_aero
from jax_aero.types import Array

HOME = Path(jax_aero.__file__).parent
FOLDERS = tuple(f"{HOME / name}/" for name in ("aero", "body", "control", "sim"))
"""Folders of the model."""

INLINE = ("jit", "pjit", "closed_call", "core_call", "checkpoint", "remat2", "custom_jvp_call", "custom_vjp_call")
"""Primitives of one inner program, which may be computed in their place."""

Sides = dict[str, Any]
"""For each choice, by file and line, whether it has gone either way: for `where`, not and as its condition says."""


@contextmanager
def watch_lines() -> Iterator[set[tuple[str, int]]]:
    """Collect file and number of every line of the model that runs."""
    seen: set[tuple[str, int]] = set()

    def line(frame: FrameType, event: str, _: Any) -> Any:
        if event == "line":
            seen.add((frame.f_code.co_filename, frame.f_lineno))
        return line

    def call(frame: FrameType, *_: Any) -> Any:
        return line if frame.f_code.co_filename.startswith(FOLDERS) else None

    before = sys.gettrace()
    sys.settrace(call)
    try:
        yield seen
    finally:
        sys.settrace(before)


def unseen_lines(seen: Iterable[tuple[str, int]]) -> dict[str, list[int]]:
    """Return the numbers of the lines of all functions of the model that have not run, by file."""
    seen, unseen = set(seen), {}
    for path in sorted(path for folder in FOLDERS for path in Path(folder).rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        lines = {number for number in _lines_of(compile(text, str(path), "exec")) if (str(path), number) not in seen}
        words = text.splitlines()
        if missing := sorted(number for number in lines if words[number - 1].strip() != "..."):
            unseen[path.relative_to(HOME).as_posix()] = missing
    return unseen


def _lines_of(code: CodeType, *, is_function: bool = False) -> set[int]:
    """Return the lines of the functions in a code; those of modules and classes run at import."""
    inner = [const for const in code.co_consts if isinstance(const, CodeType)]
    nested = set().union(*(_lines_of(one, is_function="__qualname__" not in one.co_names) for one in inner), set())
    own = {number for *_, number in code.co_lines() if number} if is_function else set()
    # The first is that of its `def`.
    return nested | {number for number in own if number > min(own)}


def unexecuted(seen: Iterable[tuple[str, int]], sides: Iterable[Mapping[str, Any]]) -> list[str]:
    """Return files with the lines that have not run, and choices with the sides that they have not taken."""
    lines = [f"{name}: {shown(numbers)}" for name, numbers in unseen_lines(seen).items()]
    return [*lines, *(f"{place}: {side}" for place, side in untaken(sides).items())]


def shown(numbers: Sequence[int]) -> str:
    """Return numbers in ascending order as ranges."""
    starts = [0, *(place + 1 for place, (a, b) in enumerate(pairwise(numbers)) if b > a + 1), len(numbers)]
    parts = [(numbers[a], numbers[b - 1]) for a, b in pairwise(starts)]
    return " ".join(str(a) if a == b else f"{a}-{b}" for a, b in parts)


# --- choices ------------------------------------------------------------------------------------------------------


def merged(sides: Iterable[Mapping[str, Any]]) -> Sides:
    """Return which sides any of them has taken."""
    total: Sides = {}
    for some in sides:
        for name, taken in some.items():
            total[name] = total.get(name, False) | np.asarray(taken)
    return total


def untaken(sides: Iterable[Mapping[str, Any]]) -> dict[str, str]:
    """Return the choices that have never gone one way, with the sides that are missing."""
    return {
        name: " and ".join(word for word, was in zip(("no", "yes"), taken, strict=True) if not was)
        for name, taken in sorted(merged(sides).items())
        if not taken.all()
    }


def count_sides(function: Callable[..., Any]) -> Callable[..., tuple[Any, Sides]]:
    """Return a function that also returns which sides the choices of its program have taken; not for derivatives."""

    def counting(*args: Any) -> tuple[Any, Sides]:
        # Of a function of its own: of one compiled before, JAX has the old program, of lines that do not run again.
        program, shape = jax.make_jaxpr(lambda *given: function(*given), return_shape=True)(*args)
        names = sorted(set(_choices(program.jaxpr)))
        count = _Count({name: 2 * place for place, name in enumerate(names)})
        taken = jnp.zeros(2 * len(names), bool)
        out, taken = count.run(program.jaxpr, program.consts, jax.tree.leaves(args), taken)
        sides = {name: taken[place : place + 2] for name, place in count.places.items()}
        return jax.tree.unflatten(jax.tree.structure(shape), out), sides

    return counting


def _choices(program: Any) -> Iterator[str]:
    for step in program.eqns:
        if name := _choice(step):
            yield name
        for inner in jax.tree.leaves(list(step.params.values()), is_leaf=lambda node: hasattr(node, "eqns")):
            if hasattr(inner, "eqns"):
                yield from _choices(getattr(inner, "jaxpr", inner))


def _choice(step: Any) -> str | None:
    """Return file and line of a choice of the model, if a step of a program is one."""
    is_where = step.primitive.name in ("jit", "pjit") and step.params["name"] == "_where"
    if not (is_where or step.primitive.name == "cond") or step.source_info.traceback is None:
        return None
    inner: list[str] = []
    for frame in step.source_info.traceback.frames:
        if frame.file_name.startswith(FOLDERS):
            is_ours = inner[-1:] == ["where"] if is_where else "platform_dependent" not in inner
            return f"{Path(frame.file_name).relative_to(HOME).as_posix()}:{frame.line_num}" if is_ours else None
        inner.append(frame.function_name)
    return None


class _Count:
    """Computes a program step by step, with the sides that its choices take."""

    def __init__(self, places: dict[str, int]) -> None:
        self.places = places

    def run(self, program: Any, consts: Any, args: Any, taken: Array) -> tuple[list[Any], Array]:
        """Return results, and the sides taken until then."""
        values = dict(zip((*program.constvars, *program.invars), (*consts, *args), strict=True))
        marks: list[tuple[int, Any]] = []
        for step in program.eqns:
            given = [item.val if isinstance(item, Literal) else values[item] for item in step.invars]
            if (name := _choice(step)) is not None:
                place, way = self.places[name], jnp.asarray(given[0]) > 0
                marks += [(place, ~jnp.all(way)), (place + 1, jnp.any(way))]
            out, taken = self._step(step, given, taken)
            values.update(zip(step.outvars, out, strict=True))
        if marks:
            places, flags = zip(*marks, strict=True)
            taken = taken.at[np.array(places)].max(jnp.stack(flags))
        return [item.val if isinstance(item, Literal) else values[item] for item in program.outvars], taken

    def _step(self, step: Any, given: list[Any], taken: Array) -> tuple[Sequence[Any], Array]:
        kind, params = step.primitive.name, step.params
        inner: Any = next((params[key] for key in ("jaxpr", "call_jaxpr", "call", "fun_jaxpr") if key in params), None)
        if kind == "scan" and any(_choices(inner.jaxpr)):
            constants, carried = params["num_consts"], params["num_consts"] + params["num_carry"]

            def along(state: Any, now: Any) -> Any:
                out, sides = self.run(inner.jaxpr, inner.consts, [*given[:constants], *state[1:], *now], state[0])
                return (sides, *out[: params["num_carry"]]), out[params["num_carry"] :]

            start, along_it = (taken, *given[constants:carried]), given[carried:]
            (taken, *last), rows = jax.lax.scan(along, start, along_it, params["length"], params["reverse"])
            return [*last, *rows], taken
        # A loop of a batch, whose condition is one for each sample, is not looked into.
        is_single = kind == "while" and params["cond_jaxpr"].out_avals[0].shape == ()
        if is_single and any(_choices(params["body_jaxpr"].jaxpr)):
            asks, body, first = params["cond_jaxpr"], params["body_jaxpr"], params["cond_nconsts"]
            second = first + params["body_nconsts"]

            def goes_on(state: Any) -> Any:
                return self.run(asks.jaxpr, asks.consts, [*given[:first], *state[1:]], state[0])[0][0]

            def once(state: Any) -> Any:
                out, sides = self.run(body.jaxpr, body.consts, [*given[first:second], *state[1:]], state[0])
                return sides, *out

            taken, *last = jax.lax.while_loop(goes_on, once, (taken, *given[second:]))
            return last, taken
        if kind == "cond" and any(name for branch in params["branches"] for name in _choices(branch.jaxpr)):
            ways = [
                lambda taken, *args, branch=branch: self.run(branch.jaxpr, branch.consts, args, taken)
                for branch in params["branches"]
            ]
            last, taken = jax.lax.switch(given[0], ways, taken, *given[1:])
            return last, taken
        if kind in (*INLINE, "custom_vmap_call") and any(_choices(getattr(inner, "jaxpr", inner))):
            return self.run(getattr(inner, "jaxpr", inner), getattr(inner, "consts", ()), given, taken)
        out = step.primitive.bind(*given, **step.primitive.get_bind_params(params))
        return out if step.primitive.multiple_results else [out], taken
