"""Commands that documents show."""

import re

FLIGHT = re.compile(r"^jax-aero fly \w.*$", re.MULTILINE)


def in_a_folder_of_its_own(commands: str) -> str:
    """Let flights write to `$OUT`, not to the results of who runs the tests."""
    return FLIGHT.sub(r'\g<0> --out "$OUT"', commands)
