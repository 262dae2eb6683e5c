"""Common functions of the command lines: error messages, interruption and progress."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jax_aero.result import Progress

REFUSED, INTERRUPTED = 2, 130
"""Exit statuses of a command."""


class Refused(ValueError):
    """A request of the user that cannot or must not be carried out; the message states the request and the reason."""


def one_line(reason: Exception) -> str:
    """Return an error's message in one line; for system errors, file and reason without the error number."""
    return f"{reason.filename}: {reason.strerror}" if isinstance(reason, OSError) and reason.filename else str(reason)


def exit_status(work: Callable[[], int | None], *, interrupted: str = "nothing was written") -> int:
    """Run a command and return its exit status: 2 after a refusal and 130 after Ctrl-C, each reported in one line."""
    try:
        return work() or 0
    except (ValueError, OSError) as reason:
        print(f"error: {one_line(reason)}", file=sys.stderr)
        return REFUSED
    except KeyboardInterrupt:
        print(f"interrupted; {interrupted}", file=sys.stderr)
        return INTERRUPTED


@contextmanager
def progress_bar(unit: str, name: str | None = None, **options: Any) -> Iterator[Progress]:
    """Yield a function of (units done, all units) that moves a progress bar.

    The bar is shown on a terminal only, unless `options`, those of tqdm, say otherwise.
    """
    from tqdm import tqdm

    with tqdm(**{"desc": name, "unit": unit, "disable": None, "leave": False, "delay": 0.1, **options}) as bar:

        def show(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        yield show
