"""Writes the flight lab, `python rust/lab/build.py WASM OUT`, from the simulator and the page that `build.mjs` made."""

from __future__ import annotations

import gzip
import lzma
import sys
from pathlib import Path

from jax_aero import rust
from jax_aero.view import web

LARGEST = 3e6
"""Size of the lab, compressed [bytes]."""

if __name__ == "__main__":
    wasm, out = map(Path, sys.argv[1:])
    web.SIMULATOR.write_bytes(lzma.compress(wasm.read_bytes(), preset=9))
    page = web.fill_page([], rust.load_config("test1"), networks=False).encode()
    size = len(gzip.compress(page))
    if size > LARGEST:
        sys.exit(f"the page has {size} bytes compressed; expected at most {LARGEST:.0f}")
    out.mkdir(parents=True, exist_ok=True)
    (out / "index.html").write_bytes(page)
    print(f"{out}: {size / 1e6:.2f} MB compressed")
