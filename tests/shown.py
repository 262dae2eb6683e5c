"""Commands that documents show."""

import re

FLIGHT = re.compile(r"^jax-aero fly \w.*$", re.MULTILINE)


def run_in_own_folder(commands: str) -> str:
    """Let flights write to `$OUT`, not to the results of who runs the tests."""
    return FLIGHT.sub(r'\g<0> --out "$OUT"', commands)
