"""What the lab draws and says, from the sources of the viewer: `python rust/lab/look.py FILE` writes it as JSON."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from jax_aero import rust
from jax_aero.view import drawing
from jax_aero.view.shapes import Mount, Shape, look_of

REPOSITORY = Path(__file__).resolve().parents[2]


def table() -> dict[str, Any]:
    """Return shapes, jets, links, colours and scales."""
    look = look_of(rust.Robot(REPOSITORY / "configs/robot/ironcub_mk1.toml"))
    names = ("FORCE", "WIND", "REFERENCE", "TRAIL", "PLUME", "GHOST", "FELL", "COMPLETED")
    scales = drawing.Scales()
    return {
        "version": rust.__version__,
        "shapes": [_shape(shape) for shape in look.shapes],
        "jets": [_mount(mount) for mount in look.jets],
        "links": [_mount(mount) for mount in look.links],
        "colours": {name.lower(): getattr(drawing, name) for name in names} | dict(drawing.ROLES),
        "scales": {"force": scales.force, "thrust": scales.thrust, "wind": scales.wind},
        "plume_radius": drawing.PLUME_RADIUS,
        "overhead": drawing.OVERHEAD,
    }


def _shape(shape: Shape) -> dict[str, Any]:
    pose = shape.body_from_shape
    return {
        "kind": shape.kind,
        "size": shape.size,
        "role": shape.role,
        "body": shape.body,
        "rotation": _rounded(pose.rotation.T),  # by columns
        "position": _rounded(pose.position),
    }


def _mount(mount: Mount) -> dict[str, Any]:
    return {
        "name": mount.name,
        "body": mount.body,
        "position": _rounded(mount.position),
        "axis": _rounded(mount.axis),
    }


def _rounded(numbers: Any) -> list[float]:
    return [round(float(number), 6) for number in numbers.ravel()]


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(json.dumps(table()), encoding="utf-8")
