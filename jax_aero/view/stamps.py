"""Times that logs of others state: numbers, texts of ISO 8601, and seconds with nanoseconds."""

from __future__ import annotations

import re
from array import array
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jax_aero.view import Refused

Array = NDArray[np.float64]

UNITS = (("sec", "nanosec"), ("sec", "nsec"), ("secs", "nsecs"), ("seconds", "nanos"))
"""Names of seconds and nanoseconds in stamps of ROS 2, Foxglove, ROS 1 and protocol buffers."""

FORMS = f"a number, {', '.join(' with '.join(pair) for pair in UNITS)}, or a text of ISO 8601"
"""What a stamp may be."""

NEAR = 60.0
"""Time between a stamp and those of its neighbours of one flight [s]."""

GREATEST = 1e300
"""Greatest time whose differences are numbers [ns]."""

ISO = re.compile(r"\d{4}-?\d\d-?\d\d[T ]")
"""Beginning of a text of ISO 8601 with date and time."""


@dataclass
class Stated:
    """Stamps of a topic's messages, in the order of the file.

    Attributes
    ----------
    times
        Of the messages that state one, from a start that all topics of the file have [ns].
    numbers
        Those messages among all of the topic, from 1.
    count
        Messages of the topic.
    without
        The first message that states none, and what stands there.
    """

    times: array[float] = field(default_factory=lambda: array("d"))
    numbers: array[int] = field(default_factory=lambda: array("q"))
    count: int = 0
    without: tuple[int, Any] | None = None

    def add(self, stamp: Any, time: float | None) -> None:
        """Count a message with this stamp, and this time if it is one [ns]."""
        self.count += 1
        if time is None:
            self.without = self.without or (self.count, stamp)
        else:
            self.times.append(time)
            self.numbers.append(self.count)

    def describe(self, topic: str, file: str) -> str | None:
        """Return how many messages state no time, if there are any."""
        if self.without is None:
            return None
        number, stamp = self.without
        count = self.count - len(self.numbers)
        what = f"{count} of {self.count} messages of `{topic}` in {file} state no time"
        return f"{what}, the first of them message {number}, with {'none' if stamp is None else repr(stamp)}"

    def check(self, topic: str, file: str) -> None:
        """Refuse a stamp that is far from those before and after it, in whatever unit they are."""
        times = 1e-9 * np.asarray(self.times)
        if times.size < 5:
            return
        windows = np.lib.stride_tricks.sliding_window_view(times, 5)
        middle = np.median(windows, axis=1)[np.clip(np.arange(times.size) - 2, 0, times.size - 5)]
        most = max(NEAR, 1e3 * float(np.median(np.abs(np.diff(times)))))
        if (places := np.flatnonzero(np.abs(times - middle) > most)).size:
            place = int(places[0])
            what = (
                f"message {self.numbers[place]} of `{topic}` in {file} states a time {times[place] - middle[place]:g} s"
            )
            raise Refused(f"{what} from those of its neighbours; expected times of one clock")


def find(message: Any, keys: Sequence[str]) -> Any:
    """Return the part of a message at a path; `None` if it is not there."""
    for key in keys:
        message = message.get(key) if isinstance(message, dict) else None
    return message


def nanoseconds(stamp: Any, scale: float) -> int | None:
    """Return the time of a stamp [ns] in one of `FORMS`, numbers having a factor to seconds; `None` for anything else.

    Numbers may be texts, and a part that is zero may be absent, as in the JSON of protocol buffers.
    """
    if isinstance(stamp, dict):
        for pair in UNITS:
            parts = [_number(stamp.get(unit, 0)) for unit in pair]
            if (stamp.keys() >= set(pair) or stamp.keys() <= set(pair)) and None not in parts:
                return _rounded(parts[0], 10**9, parts[1])
        return None
    if isinstance(stamp, str) and ISO.match(stamp):
        import pandas as pd

        try:
            return int(pd.Timestamp(stamp).value)
        except ValueError:
            return None
    number, factor = _number(stamp), scale * 1e9
    return _rounded(number, int(factor) if factor == int(factor) else factor)


def _number(part: Any) -> int | float | None:
    """Return a number, or that of a text."""
    if isinstance(part, str):
        for kind in (int, float):
            try:
                return kind(part)
            except ValueError:
                continue
    return part if isinstance(part, int | float) and not isinstance(part, bool) else None


def _rounded(number: int | float | None, factor: int | float, more: int | float | None = 0) -> int | None:
    """Return a multiple of a number, and more, as integer: exactly for integers."""
    if number is None or more is None:
        return None
    product = number * factor + more
    return round(product) if abs(product) < GREATEST else None


def seconds_of_texts(texts: Sequence[str], places: Sequence[str], refusal: str) -> Array:
    """Return texts of ISO 8601 as times from the first one [s]; NaN where there is none.

    Raises
    ------
    Refused
        For another text, naming its place if most are of ISO 8601, else with `refusal`.
    """
    import pandas as pd

    column = pd.to_datetime(pd.Series(texts, dtype=object), format="ISO8601", utc=True, errors="coerce")
    is_other = column.isna().to_numpy() & np.array([bool(text) and text == text for text in texts])
    if 2 * is_other.sum() >= max(len(texts), 1):
        raise Refused(f"{refusal}, or ISO 8601")
    if is_other.any():
        row = int(is_other.argmax())
        raise Refused(f"{places[row]} is {texts[row]}; expected ISO 8601, as in most rows")
    return seconds(column)


def seconds(column: Any) -> Array:
    """Return timestamps or durations of pandas as times from the first [s]."""
    return np.asarray((column - column.iloc[0]).dt.total_seconds())
