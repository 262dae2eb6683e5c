"""Progress of a sweep and its expected end: one updated line on a terminal, occasional lines in a file."""

from __future__ import annotations

import sys
import time
from types import TracebackType

LINE_INTERVAL = 15.0
"""Time between two lines if the output is not a terminal [s]."""
MOVE_INTERVAL = 0.2


class Progress:
    """Counter of flights; those of earlier runs count as done but are not used for the rate."""

    def __init__(self, name: str, total: int, done: int) -> None:
        self._name, self._total, self._done, self._before = name, total, done, done
        self._within = 0
        self._begin = self._shown = time.monotonic()
        self._moves = sys.stderr.isatty()

    def __enter__(self) -> Progress:
        if self._before:
            print(f"{self._name}: {self._before} of {self._total} flights are there already", file=sys.stderr)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._moves:
            print(file=sys.stderr)

    def within_chunk(self, done: int, _: int) -> None:
        """Set the number of flights that have ended in the present chunk."""
        self._within = done
        self._show(MOVE_INTERVAL if self._moves else LINE_INTERVAL)

    def chunk_done(self, flights: int) -> None:
        """Count the flights of a chunk that is on the disk."""
        self._within = 0
        self._done += flights
        last = self._done >= self._total
        self._show(0.0 if last or self._moves else LINE_INTERVAL)

    def _show(self, interval: float) -> None:
        now = time.monotonic()
        if now - self._shown < interval:
            return
        self._shown = now
        print(self.line(now - self._begin), end="\r" if self._moves else "\n", file=sys.stderr, flush=True)

    def line(self, seconds: float) -> str:
        """Return the progress in words after some seconds of flying."""
        done = self._done + self._within
        rate = (done - self._before) / seconds if seconds > 0.0 else 0.0
        left = (self._total - done) / rate if rate else None
        eta = "" if left is None else f", {_clock(left)} left"
        return f"{self._name}: {done} of {self._total} flights, {60.0 * rate:.0f} per minute{eta}   "


def _clock(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"
