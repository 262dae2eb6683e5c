"""Blocks of inputs that a network of aerodynamic forces may have, and how many numbers each holds."""

from __future__ import annotations

from typing import Literal, TypeAlias, get_args

Block: TypeAlias = Literal["wind", "joints", "link_wind", "link_position", "link_shadow"]

BLOCKS: tuple[Block, ...] = get_args(Block)


def block_sizes(joints: int, links: int) -> dict[Block, int]:
    """Return the number of features in every block, from the numbers of input joints and links."""
    return {"wind": 3, "joints": joints, "link_wind": 3 * links, "link_position": 3 * links, "link_shadow": links}
