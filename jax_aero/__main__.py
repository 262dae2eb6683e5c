"""Commands of the library.

`verify` compares the Rust crate with JAX; `view` shows flights in the browser and flies
them there; `video` and `snapshot` draw them into files.
"""

import importlib
import sys

COMMANDS = {
    "verify": "jax_aero.verify.command:main",
    "view": "jax_aero.view.command:view",
    "video": "jax_aero.view.command:video",
    "snapshot": "jax_aero.view.command:snapshot",
}


def main(arguments: list[str]) -> int:
    """Run the command that is named first."""
    if not arguments or arguments[0] not in COMMANDS:
        print(f"usage: python -m jax_aero {{{','.join(COMMANDS)}}} ...", file=sys.stderr)
        return 2
    module, function = COMMANDS[arguments[0]].split(":")
    status: int = getattr(importlib.import_module(module), function)(arguments[1:])
    return status


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
