"""Studies: results other than flights, such as a trim or an optimal trajectory. One folder each, like a flight's.

A kind of study consists of a type of configuration and a function from it to findings. The configuration is a TOML file
of the study's folder, with paths relative to that file, or, if there is none, the defaults of the type. Keys
changed by --set give a separate result (`changes`). Keys, flights and every file named enter the digest,
by which an outdated result is recognised.
"""

from __future__ import annotations

import argparse
import os
import re
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from msgspec import structs

from jax_aero import rust
from jax_aero.base import arguments, kinds, places, plain_values, tables
from jax_aero.base.arguments import Parser, complete_with
from jax_aero.base.files import lock_work
from jax_aero.base.keys import parse_assignments, parts, set_key
from jax_aero.base.references import file_hash
from jax_aero.base.terminal import Refused, exit_status
from jax_aero.results import manifest, record
from jax_aero.results.changes import folder_suffix, options_of
from jax_aero.results.identity import Identity
from jax_aero.results.work import Work

if TYPE_CHECKING:
    import xarray as xr

C = TypeVar("C", bound=tables.Table)


@dataclass(frozen=True)
class Findings:
    """Result of a study."""

    title: str
    dataset: xr.Dataset
    summary: Mapping[str, Any]
    """Figures that are printed and stored in the manifest; `None` for a missing number."""
    flights: Mapping[str, rust.Config] = field(default_factory=dict)
    """Resolved configurations that the result depends on."""
    results: Mapping[str, str] = field(default_factory=dict)
    """Digests of the configurations of flights whose results are read, by name."""
    inputs: Mapping[str, Any] = field(default_factory=dict)
    """Other inputs that the result depends on."""
    files: Sequence[Path] = ()
    """Files that the result depends on, besides those named in the configuration and read by the study."""
    texts: Mapping[str, str | bytes] = field(default_factory=dict)
    """Additional files of the result, by name."""
    timings: Mapping[str, float] = field(default_factory=dict)
    """Wall times of parts of the study [s]."""
    report: str = ""
    """Text that is printed instead of the summary."""


@dataclass(frozen=True)
class Study(Generic[C]):
    """One kind of study."""

    kind: str
    """Name of the folders of configurations and of results."""
    about: str | None
    config: type[C]
    compute: Any
    """Function that returns `Findings`, from name and configuration, and if it `resumes` also from unfinished work."""
    names: Sequence[str]
    """Studies that are computed if none is named."""
    backend: str = "casadi"
    """Package that does the computation."""
    options: Sequence[str] = ()
    """Additional words of its command line."""
    reads: Callable[[str, C], Sequence[Path]] = lambda *_: ()
    """Function from name and configuration to the files that the study reads, besides those named in the latter."""
    resumes: bool = False
    """Whether an interrupted one goes on where it stopped."""

    @property
    def command(self) -> str:
        """Return the words of its command."""
        return kinds.find(self.kind).command

    @property
    def example(self) -> str:
        """Return a key of its configuration with a value."""
        return example_of(self.kind, self.config)

    def main(self, arguments: Sequence[str] | None = None) -> int:
        """Run the command line; return its exit status."""
        parser = Parser(self.command, self.about)
        add_names(parser, self.kind, nargs="*", default=self.names)
        add_set(parser, self.example)
        add_name(parser)
        add_overwrite(parser)
        given = parser.parse_args(arguments)

        def work() -> None:
            check_name(given)
            for name in given.names:
                self.run(name, parse_assignments(given.set), named=given.named, overwrite=given.overwrite)

        goes_on = "the same command goes on where this one stopped"
        return exit_status(work, interrupted=goes_on if self.resumes else "nothing was written")

    def read(self, name: str, changes: Mapping[str, Any] | None = None) -> tuple[str, C]:
        """Return name and configuration of a study given by name or path."""
        if places.names(self.kind):
            path = find(self.kind, name)
            return result_name(self.kind, path), tables.load(path, self.config, changes)
        table: dict[str, Any] = {}
        for key, value in (changes or {}).items():
            set_key(table, key, value)
        return name, tables.convert(table, self.config, self.command)

    def run(
        self,
        name: str,
        changes: Mapping[str, Any] | None = None,
        *,
        named: str | None = None,
        overwrite: bool = False,
    ) -> dict[str, Any]:
        """Compute, write and print a study, whose result may be `named`; return the manifest.

        A result of the same keys and files is computed anew, since the flights that it depends on are known only after
        the computation. A result of others is replaced only with `overwrite`.
        """
        started = time.perf_counter()
        given = options_of(changes or {}, named)
        command = ["jax-aero", *self.command.split(), name, *self.options, *given]
        name, config = self.read(name, changes)
        folder = places.RESULTS / self.kind / folder_name(self.kind, places.name_of(name), changes or {}, named)
        with lock_work(folder):
            read = [*tables.files(config), *self.reads(name, config)]
            record.check_replaceable(folder, lambda kept: _is_of(config, read, kept), overwrite=overwrite)
            table = plain_values.to_builtins(config)
            under_way = [Work.on(folder, Identity.of({"config": table}, read))] if self.resumes else []
            findings: Findings = self.compute(name, config, *under_way)
            timings = {**findings.timings, "all": time.perf_counter() - started}
            flights = {key: rust.config_digest(flight) for key, flight in findings.flights.items()}
            flights |= findings.results
            files = [*read, *findings.files]
            inputs = findings.inputs
            identity = Identity.of({"config": table, "inputs": inputs, "flights": flights}, files)
            document = manifest.build(
                folder.name,
                findings.title,
                table,
                identity,
                summary=findings.summary,
                command=command,
                backend=self.backend,
                sources={
                    "inputs": manifest.make_portable(inputs),
                    "flights": flights,
                    "configurations": manifest.make_portable(findings.flights),
                    "files": file_hashes(files),
                },
                timings_s={key: round(seconds, 4) for key, seconds in timings.items()},
            )
            dataset = findings.dataset.assign_attrs(title=findings.title, config_hash=identity.digest)
            record.write_run(folder, dataset, document, replace=True, texts=findings.texts)
            for work in under_way:
                work.clear()
        print(f"{findings.title}\n{findings.report or listing(findings.summary)}")
        print(f"{manifest.make_portable(folder)}: {', '.join(sorted(path.name for path in folder.iterdir()))}")
        return document


def _is_of(config: tables.Table, files: Sequence[Path], kept: Mapping[str, Any]) -> bool:
    """Return whether a manifest is that of a result with these keys and with these files in their present state."""
    same_files = file_hashes(files).items() <= kept.get("sources", {}).get("files", {}).items()
    return same_files and bool(kept.get("config") == manifest.make_portable(plain_values.to_builtins(config)))


def file_hashes(files: Iterable[Path]) -> dict[str, str]:
    """Return the hashes of files by path; files of one name outside the repository share an entry."""
    by_path: dict[str, set[str]] = {}
    for path in files:
        by_path.setdefault(manifest.make_portable(path), set()).add(file_hash(path))
    return {path: " ".join(sorted(hashes)) for path, hashes in by_path.items()}


def listing(summary: Mapping[str, Any]) -> str:
    """Return the figures of a summary, one per line, or those of a case."""
    width = max((len(key) for key in summary), default=0)
    return "\n".join(f"  {key:<{width}}  {_shown(value)}" for key, value in summary.items())


def _shown(value: Any) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {_shown(figure)}" for key, figure in value.items())
    return format(value, ".5g") if isinstance(value, int | float) else str(value)


def add_names(parser: Any, kind: str, name: str = "names", **options: Any) -> None:
    """Add the argument for files of `configs/KIND`, or for names if there is no such folder, with Tab completion."""
    about = f"a file stem in {places.shown_folder(kind)}, or a path" if places.names(kind) else "a name"
    if default := options.get("default"):
        about += f" (default {default if isinstance(default, str) else ' '.join(default)})"
    complete_with(parser.add_argument(name, metavar="NAME", help=about, **options), lambda: places.names(kind))


def add_choice(parser: argparse.ArgumentParser, kind: str) -> None:
    """Add names of files of `configs/KIND`, or instead `--all` of them, and `--list`."""
    which = parser.add_mutually_exclusive_group()
    add_names(which, kind, nargs="*", default=[])
    which.add_argument("--all", action="store_true", help=f"every file of configs/{kind}")
    parser.add_argument("--list", action="store_true", help=f"list the files of configs/{kind} and stop")


def add_set(parser: argparse.ArgumentParser, example: str = "wind.velocity=[0,-12,0]") -> None:
    """Add the option that changes keys of a configuration, with an example of the command's own."""
    text = f"change one key of the configuration; the value as in TOML{example and f', e.g. {example}'}"
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help=text)


def example_of(kind: str, config: type[tables.Table] | None = None) -> str:
    """Return a number of the first file of a kind, or of its type's own values, as `--set` takes it; empty for none."""
    written = [tables.read(find(kind, name)) for name in places.names(kind)[:1]]
    own = [] if config is None else [{field.name: field.default for field in structs.fields(config)}]
    numbers = (
        item
        for table in (*written, *own)
        for item in parts(table)
        if type(item[1]) in (int, float) and not re.search(r"\.\d", item[0])
    )
    return "=".join(map(str, next(numbers, ())))


def add_name(parser: argparse.ArgumentParser) -> None:
    """Add the option that names the result."""
    arguments.add_name(parser, "default: that of the file, followed by the changes")


def check_name(given: argparse.Namespace) -> None:
    """Refuse one name for the results of several configurations."""
    if given.named and len(given.names) > 1:
        raise Refused(f"--name is {given.named} for {len(given.names)} results; expected one")


def folder_name(kind: str, name: str, changes: Mapping[str, Any], named: str | None) -> str:
    """Return the name of a result's folder: `named`, or that of the configuration, followed by its changes.

    A name given to it must not be that of a shipped configuration, whose result would be taken for another one.
    """
    if named is None:
        return name + folder_suffix(changes)
    if named in places.names(kind):
        raise Refused(f"--name is {named}, the name of {places.shown_folder(kind)}/{named}.toml; expected another")
    return named


def add_overwrite(parser: argparse.ArgumentParser) -> None:
    """Add the option that replaces a result of another configuration."""
    parser.add_argument("--overwrite", action="store_true", help="replace the result of another configuration")


def own_controller(text: str) -> dict[str, str]:
    """Return the table of a controller that is given as FILE.py:NAME."""
    file, _, name = text.rpartition(":")
    if not Path(file).is_file() or not name.isidentifier():
        raise Refused(f"a controller is {text}; expected FILE.py:NAME, a function or class in a file that is there")
    return {"file": str(Path(file).resolve()), "name": name}


def find(kind: str, name: str) -> Path:
    """Return the configuration of a kind, given by name or path."""
    path = places.find(kind, name)
    if not path.is_file():
        raise Refused(f"there is no file {path}")
    return path


def result_name(kind: str, path: Path, named: str | None = None) -> str:
    """Return the name of a configuration's result; refuse that of another, shipped configuration.

    It is the name of the file, unless the file gives one itself (`named`).
    """
    name = path.stem if named is None else named
    shipped = places.folder_of(kind) / f"{name}.toml"
    if shipped.is_file() and not shipped.samefile(path):
        raise Refused(
            f"{path}: its result would take the place of that of {places.shown_folder(kind)}/{shipped.name}; rename it"
        )
    return name


def print_titles(kind: str) -> None:
    """Print name and title of every file of `configs/KIND` by its source, or the error if it cannot be read."""
    groups: dict[str, list[str]] = {"after the paper": [], "iRonCub-Mk3": [], "ours": []}
    for name in places.names(kind):
        groups[_group(places.find(kind, name))].append(name)
    width = max((len(name) for names in groups.values() for name in names), default=0)
    for group, names in groups.items():
        if names:
            print(f"{group}:")
        for name in names:
            try:
                title = tables.read(places.find(kind, name)).get("title", "")
            except Refused as reason:
                title = f"({reason})"
            print(f"  {name:<{width}}  {title}")


def _group(path: Path) -> str:
    """Return the group of a configuration in a list: by the comment that names its source."""
    if path.stem.startswith("mk3_"):
        return "iRonCub-Mk3"
    text = path.read_text(encoding="utf-8", errors="replace")
    return "after the paper" if re.search(r"^# Source: (paper|the published)\b", text, re.MULTILINE) else "ours"


def schema_of(kind: str, folder: Path) -> str:
    """Return the path of the schema for a kind of file, relative to a folder."""
    return os.path.relpath(places.CONFIGS / "schema" / f"{kind}.schema.json", folder.resolve())


def write_with_schema(path: Path, kind: str, text: str) -> None:
    """Write a file whose first line names the schema of its kind, with which editors complete keys."""
    path.write_text(f"#:schema {schema_of(kind, path.parent)}\n{text}", encoding="utf-8")
