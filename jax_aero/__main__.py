"""`python -m jax_aero verify` says whether the Rust controller agrees with the JAX reference."""

import sys

from jax_aero import verify

COMMANDS = {"verify": verify.main}


def main(arguments: list[str]) -> int:
    """Run the command that is named first."""
    if not arguments or arguments[0] not in COMMANDS:
        print(f"usage: python -m jax_aero {{{','.join(COMMANDS)}}} ...", file=sys.stderr)
        return 2
    return COMMANDS[arguments[0]](arguments[1:])


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
