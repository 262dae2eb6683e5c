"""Checkpoints of a training run: everything that the next epoch depends on, in one file with a checksum."""

from __future__ import annotations

import io
import json
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from jax_aero.base.files import seal, unseal, write_bytes

KIND = "checkpoint"


class Checkpoint(NamedTuple):
    """State of a run after some epochs."""

    digest: str
    """Digest of settings and samples; the checkpoint of another run is refused."""
    epoch: int
    """Number of completed epochs."""
    state: Any
    """Weights, moments of Adam, best weights so far: any pytree of arrays."""
    facts: dict[str, Any]
    """Loss curves and the state of early stopping, stored as JSON."""


def save_checkpoint(path: str | PathLike[str], checkpoint: Checkpoint) -> None:
    """Write a checkpoint; the file is written completely or not at all."""
    leaves = {f"leaf_{i}": np.asarray(leaf) for i, leaf in enumerate(jax.tree.leaves(checkpoint.state))}
    meta = json.dumps({"digest": checkpoint.digest, "epoch": checkpoint.epoch, "facts": checkpoint.facts})
    stream = io.BytesIO()
    np.savez(stream, meta=np.array(meta), **leaves)  # type: ignore[arg-type]  # the stub forbids names from a dict
    write_bytes(Path(path), seal(stream.getvalue(), KIND))


def load_checkpoint(path: str | PathLike[str], like: Any, digest: str) -> Checkpoint | None:
    """Read the checkpoint of the same run, or return `None` if there is none; `like` is a pytree of the same shapes.

    Raises
    ------
    ValueError
        If the file is a checkpoint of another run, or damaged.
    """
    target = Path(path)
    if not target.is_file():
        return None
    if (content := unseal(target.read_bytes(), KIND)) is None:
        raise ValueError(f"{target.name} is no checkpoint, or damaged: its checksum is another; remove it")
    expected, structure = jax.tree.flatten(like)
    with np.load(io.BytesIO(content), allow_pickle=False) as file:
        meta = json.loads(str(file["meta"]))
        if meta["digest"] != digest:
            raise ValueError(f"{target.name} belongs to other settings or data; remove it, or restart")
        leaves = [file[f"leaf_{i}"] for i in range(len(expected))]
    for leaf, model in zip(leaves, expected, strict=True):
        if leaf.shape != np.shape(model) or leaf.dtype != np.asarray(model).dtype:
            raise ValueError(f"{target.name} holds {leaf.dtype}{leaf.shape}; expected {np.shape(model)}")
    state = jax.tree.unflatten(structure, [jax.numpy.asarray(leaf) for leaf in leaves])
    return Checkpoint(digest, int(meta["epoch"]), state, meta["facts"])
