"""Checkpoints of a run: everything that its next step depends on, in one file with a seal."""

from __future__ import annotations

import io
import json
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from jax_aero.base.files import seal, unseal, write_bytes


class Checkpoint(NamedTuple):
    """State of a run."""

    state: Any
    """Weights, moments of Adam: any pytree of arrays."""
    facts: dict[str, Any]
    """Number of finished steps, loss curves: what is stored as JSON."""


def save_checkpoint(path: str | PathLike[str], of: str, checkpoint: Checkpoint) -> None:
    """Write a checkpoint, sealed with what the run is of; the file is written completely or not at all."""
    leaves = {f"leaf_{i}": np.asarray(leaf) for i, leaf in enumerate(jax.tree.leaves(checkpoint.state))}
    stream = io.BytesIO()
    np.savez(stream, facts=np.array(json.dumps(checkpoint.facts)), **leaves)  # type: ignore[arg-type]  # the stub forbids names from a dict
    write_bytes(Path(path), seal(stream.getvalue(), of))


def load_checkpoint(path: str | PathLike[str], of: str, like: Any) -> Checkpoint | None:
    """Read the checkpoint of the same run; `like` is a pytree of the same shapes.

    `None` if there is none, and for one that is damaged or of another run: the run begins anew.
    """
    target = Path(path)
    content = unseal(target.read_bytes(), of) if target.is_file() else None
    if content is None:
        return None
    expected, structure = jax.tree.flatten(like)
    with np.load(io.BytesIO(content), allow_pickle=False) as file:
        leaves = [jax.numpy.asarray(file[f"leaf_{i}"]) for i in range(len(expected))]
        return Checkpoint(jax.tree.unflatten(structure, leaves), json.loads(str(file["facts"])))
