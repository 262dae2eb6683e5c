"""What the lab draws and says, from the sources of the viewer: `python rust/lab/look.py FILE` writes it as JSON."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from jax_aero import places, rust
from jax_aero.view.shapes import look_of
from jax_aero.view.web import look_table

if __name__ == "__main__":
    robot = places.find("robot", "ironcub_mk1")
    Path(sys.argv[1]).write_text(json.dumps(look_table(look_of(rust.Robot(robot), robot))), encoding="utf-8")
