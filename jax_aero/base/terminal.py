"""Common functions of the command lines: output, error messages, interruption and progress."""

from __future__ import annotations

import io
import json
import os
import signal
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from typing import Any

Progress = Callable[[int, int], None]
"""Called with (ticks flown, all ticks), or with numbers of flights for a batch, and of pictures for a video."""

REFUSED, INTERRUPTED, CLOSED = 2, 130, 141
"""Exit statuses of a command; the last one after the reader of its output has gone, as with `| head`."""


class Refused(ValueError):
    """A request of the user that cannot or must not be carried out; the message states the request and the reason."""


class ConfigError(Refused):
    """A file or value of a configuration that is refused; the message states what its attributes hold.

    Attributes
    ----------
    file
        File in which the error is, if any.
    key
        Full dotted key, or another name of the item.
    value
        Value as text.
    expected
        What is accepted.
    suggestions
        Keys that were probably meant.
    """

    def __init__(
        self,
        message: str,
        *,
        file: str | None = None,
        key: str | None = None,
        value: str | None = None,
        expected: str | None = None,
        suggestions: tuple[str, ...] = (),
    ) -> None:
        super().__init__(message)
        self.file, self.key, self.value, self.expected, self.suggestions = file, key, value, expected, suggestions

    @classmethod
    def of(cls, key: str, value: Any, expected: str) -> ConfigError:
        """Return the refusal of a value; the whole table has an empty key."""
        text = json.dumps(value, ensure_ascii=False, separators=(",", ":"), default=repr)
        return cls._of_text(key, f"{text[:79]}…" if len(text) > 80 else text, expected)

    @classmethod
    def _of_text(cls, key: str, value: str, expected: str) -> ConfigError:
        name = f"`{key}`" if key else "the whole"
        return cls(f"{name} is {value}; expected {expected}", key=key or None, value=value, expected=expected)

    def in_file(self, file: str) -> ConfigError:
        """Return this error, in a file."""
        return ConfigError(f"{file}: {self}", **{**vars(self), "file": file})

    def in_table(self, key: str, table: Any) -> ConfigError:
        """Return this error, made by `of` for a table, with that table's own key."""
        expected = self.expected or ""
        if self.key is None:
            return self.of(key, table, expected)
        return self._of_text(f"{key}.{self.key}" if key else self.key, self.value or "", expected)


def missing_package(what: str, missing: ModuleNotFoundError, extras: str) -> str:
    """Return the message about a package that is not installed: what needs it, and the extras that bring it."""
    how = f"in a clone `make setup`, else pip install 'WHEEL[{extras}]' with the file of jax-aero"
    return f"{what} needs the package `{package_of(missing)}` of the extra `{extras}`: {how}"


def package_of(missing: ModuleNotFoundError) -> str:
    """Return the package of a module that is not there."""
    return (missing.name or "").partition(".")[0]


def one_line(reason: Exception) -> str:
    """Return an error's message in one line; for system errors, file and reason without the error number."""
    return f"{reason.filename}: {reason.strerror}" if isinstance(reason, OSError) and reason.filename else str(reason)


_WARNED: set[str] = set()


def _warn_once(message: Warning | str, *_: Any, **__: Any) -> str:
    """Return what is printed of a warning, which several readers of a file may raise."""
    repeated, line = str(message) in _WARNED, f"warning: {message}\n"
    _WARNED.add(str(message))
    return "" if repeated else line


def exit_status(work: Callable[[], int | None], *, interrupted: str = "nothing was written") -> int:
    """Run a command and return its exit status: 2 after a refusal and 130 after Ctrl-C, each reported in one line.

    So are warnings about the user's files, once each.
    """
    warnings.formatwarning = _warn_once
    try:
        return work() or 0
    except BrokenPipeError:
        raise
    except (ValueError, OSError) as reason:
        return refuse(one_line(reason))
    except KeyboardInterrupt:
        print(f"interrupted; {interrupted}", file=sys.stderr)
        return INTERRUPTED


ACTING = (*range(0x20), *range(0x7F, 0xA0), 0x61C, 0x200E, 0x200F, *range(0x202A, 0x202F), *range(0x2066, 0x206A))
"""Characters that a terminal does not show but interprets, and those that change the direction of writing."""

SHOWN = {code: f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}" for code in ACTING if chr(code) not in "\t\n"}


class Printable:
    r"""A stream that shows characters of `ACTING`, which texts of files may contain, as `\x1b`."""

    def __init__(self, stream: Any) -> None:
        self.stream = stream

    def write(self, text: str) -> int:
        """Write a text."""
        written: int = self.stream.write(text.translate(SHOWN))
        return written

    def __getattr__(self, name: str) -> Any:
        return getattr(self.stream, name)


@contextmanager
def printable_output() -> Iterator[None]:
    """Make output and errors printable during the block."""
    output: Any = sys.stdout and Printable(sys.stdout)  # none where it is closed
    errors: Any = sys.stderr and Printable(sys.stderr)
    with redirect_stdout(output), redirect_stderr(errors):
        yield


def terminal() -> Any:
    """Return the stream of errors for a progress bar, which moves the cursor."""
    return getattr(sys.stderr, "stream", sys.stderr)


def refuse(message: str) -> int:
    """Report a refusal; return its exit status."""
    print(f"error: {message}", file=sys.stderr)
    return REFUSED


def run_with_output(work: Callable[[], int]) -> int:
    """Run a whole command and write all its output; return its exit status.

    Characters that the output's encoding lacks are replaced, and those that control a terminal are shown. A closed pipe
    ends the command with 141, silently.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper) and stream.errors == "strict":
            stream.reconfigure(errors="replace")
    _obey_signals()
    with printable_output():
        try:
            try:
                return work()
            finally:
                print(end="", flush=True)  # errors of buffered output occur here rather than after the exit
        except KeyboardInterrupt:
            print("interrupted", file=sys.stderr)
            return INTERRUPTED
        except OSError as reason:  # such as a full disk or a read-only folder
            _discard_unwritable_output()
            return CLOSED if isinstance(reason, BrokenPipeError) else refuse(one_line(reason))


def _obey_signals() -> None:
    """End as by Ctrl-C when the system stops the process or closes its terminal, unless that is ignored."""
    for number in (getattr(signal, name, None) for name in ("SIGTERM", "SIGHUP")):
        if number and signal.getsignal(number) is signal.SIG_DFL:
            with suppress(ValueError):  # in another thread, which gets no signals
                signal.signal(number, signal.default_int_handler)


def _discard_unwritable_output() -> None:
    """Redirect streams that cannot be written to the null device, since Python flushes them again at its exit."""
    for stream in filter(None, (sys.stdout, sys.stderr)):
        try:
            stream.flush()
        except OSError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


@contextmanager
def progress_bar(unit: str, name: str | None = None, **options: Any) -> Iterator[Progress]:
    """Yield a function of (units done, all units) that moves a progress bar.

    The bar is shown on a terminal only, unless `options`, those of tqdm, say otherwise.
    """
    from tqdm import tqdm

    defaults = {"file": terminal(), "unit": unit, "disable": None, "leave": False, "delay": 0.1}
    with tqdm(**defaults | {"desc": name and name.translate(SHOWN), **options}) as bar:

        def show(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        yield show
