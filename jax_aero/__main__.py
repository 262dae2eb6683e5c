"""`python -m jax_aero COMMAND`, the same as `jax-aero COMMAND`."""

import sys

from jax_aero.cli import main

if __name__ == "__main__":
    sys.exit(main())
