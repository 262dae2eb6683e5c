"""Files of trained weights: `NAME.safetensors`, and beside it the card `NAME.json` that describes them.

The card states inputs, outputs and architecture, and the record of the training. The crate alone reads and checks both
(`rust.read_network`, `rust.read_policy`).
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from safetensors.numpy import save as dump_tensors

from jax_aero.base.files import read_bytes, read_text, write_bytes, write_text

VERSION = 1


def make_card(
    kind: str, name: str, tensors: Mapping[str, Any], *, description: str, training: Mapping[str, Any], **about: Any
) -> tuple[dict[str, Any], bytes]:
    """Return a card and the file of its weights, in single precision; `about` are its tables for this kind."""
    arrays = {key: np.ascontiguousarray(value, dtype=np.float32) for key, value in tensors.items()}
    for key, value in arrays.items():
        if not np.isfinite(value).all():
            place = tuple(int(index) for index in np.argwhere(~np.isfinite(value))[0])
            raise ValueError(f"tensor `{key}` is {value[place]} at {place}; expected finite numbers")
    content = dump_tensors(arrays)
    card = {
        "format": kind,
        "version": VERSION,
        "name": name,
        "description": description,
        "weights": {"file": f"{name}.safetensors", "sha256": hashlib.sha256(content).hexdigest()},
        **about,
        "training": dict(training),
    }
    return card, content


def card_path(path: str | PathLike[str]) -> Path:
    """Return the path of a card; refuse one that does not end in .json."""
    target = Path(path)
    if target.suffix.lower() != ".json":
        raise ValueError(f"path is {target.name!r}; expected the card's name, ending in .json")
    return target


def write_card(target: Path, card: Mapping[str, Any], tensors: bytes) -> None:
    """Write a card and, beside it, its weights."""
    text = card_text(card)  # refused before anything is written
    # Weights first: a card never names missing weights, and an old card refuses new weights by their hash.
    write_bytes(target.with_suffix(".safetensors"), tensors)
    write_text(target, text)


def card_text(card: Mapping[str, Any]) -> str:
    """Return the content of a card's file."""
    return f"{json.dumps(card, indent=2, ensure_ascii=False, allow_nan=False)}\n"


def copy_card(source: str | PathLike[str], path: str | PathLike[str]) -> None:
    """Copy a card and its weights to the name of `path` (ending in .json)."""
    target, origin = card_path(path), Path(source)
    card = json.loads(read_text(origin))
    tensors = read_bytes(origin.with_name(card["weights"]["file"]))
    weights = {**card["weights"], "file": f"{target.stem}.safetensors"}
    write_card(target, {**card, "name": target.stem, "weights": weights}, tensors)
