"""The command `jax-aero`: its sub-commands, how it refuses, how it ends; and where files lie."""

import ast
import functools
import importlib
import importlib.util
import io
import os
import re
import shutil
import signal
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from jax_aero import __main__ as commands
from jax_aero import cli, rust
from jax_aero.base import places
from jax_aero.base.terminal import exit_status, progress_bar
from jax_aero.commands import study as studies

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


CONFIGURED = [name for name in studies.names() if places.names(name)]
"""Studies with configurations."""


@functools.cache
def find_first_imports(path: Path) -> frozenset[str]:
    """Modules that a file imports before any of its functions is called."""
    found, nodes = set(), [ast.parse(path.read_bytes())]
    while nodes:
        match nodes.pop():
            case ast.Import(names):
                found |= {alias.name for alias in names}
            case ast.ImportFrom(str(module), names):
                found |= {module, *(f"{module}.{alias.name}" for alias in names)}
            case ast.If(ast.Name("TYPE_CHECKING"), _, otherwise):
                nodes += otherwise
            case ast.Module() | ast.ClassDef() | ast.If() | ast.Try() | ast.With() as node:
                nodes += ast.iter_child_nodes(node)
    return frozenset(found)


def packages_of(module: str) -> set[str]:
    """Packages that have to be there before a module of ours can be used, by the name of their import."""
    packages, waiting, seen = set(), {module}, set()
    while waiting:
        seen.add(name := waiting.pop())
        top, *below = name.split(".")
        if top not in {"jax_aero", "experiments", "paper_figs"}:
            packages |= {top} - sys.stdlib_module_names
            continue
        path = ROOT.joinpath(top, *below)
        files = [path.joinpath("__init__.py"), path.with_suffix(".py")]
        parents = {name.rpartition(".")[0]} - {""}
        waiting |= parents.union(*(find_first_imports(file) for file in files if file.is_file())) - seen
    return packages


def packages_in(extras: str) -> set[str]:
    """Packages that these extras bring, by the name of their import."""
    brought = {"PIL": "pillow", "markdown_it": "markdown-it-py", "sklearn": "scikit-learn", "warp": "warp-lang"}
    packages, waiting = set(), [*PROJECT["dependencies"], f"jax-aero[{extras}]"]
    while waiting:
        name, below = re.match(r"([\w-]+)(?:\[([\w,-]+)\])?", waiting.pop()).groups()
        packages.add(next((imported for imported, package in brought.items() if package == name), name))
        if name == "jax-aero":
            waiting += [entry for extra in below.split(",") for entry in PROJECT["optional-dependencies"][extra]]
    return packages


@pytest.mark.parametrize(("command", "extras"), [(name, of.needs) for name, of in cli.COMMANDS.items() if of.module])
def test_the_extras_of_a_command_bring_what_it_imports(command, extras):
    """Otherwise the hint after a missing package would not help."""
    function = cli.function_of(command)
    of = function.__self__.compute if hasattr(function, "__self__") else function  # of a `Study`
    assert packages_of(of.__module__) <= packages_in(extras)


BESIDE = """
import sys
from jax_aero import cli
from jax_aero.base import places
assert not places.IS_CHECKOUT
commands = [name for name, of in cli.COMMANDS.items() if of.module and not name.startswith("report")]
print(len([cli.function_of(name) for name in commands]), {"experiments", "paper_figs"} & {*sys.modules})
print([cli.main(words.split()) for words in ("fly --list", "sweep --list", "study", "report", "figures fig5")])
"""


@pytest.mark.slow
def test_without_a_checkout_commands_work_beside_packages_of_a_user_that_have_the_names_of_its_folders(tmp_path):
    """As from a wheel; what needs a checkout says so."""
    site, here = tmp_path / "site", tmp_path / "here"
    shutil.copytree(ROOT / "jax_aero", site / "jax_aero", copy_function=os.symlink)
    for package in ("experiments", "paper_figs"):
        (here / package).mkdir(parents=True)
        (here / package / "__init__.py").write_text("raise RuntimeError('of a user')\n")
    answer = subprocess.run(
        [sys.executable, "-c", BESIDE], cwd=here, env=os.environ | {"PYTHONPATH": str(site)}, capture_output=True,
        text=True, check=False,
    )  # fmt: skip
    first, *_, last = answer.stdout.splitlines() or [""]
    assert first == f"{sum(bool(of.module) for of in cli.COMMANDS.values()) - 2} set()", answer.stderr
    assert last == "[0, 0, 2, 2, 2]", answer.stderr
    assert answer.stderr.count("needs a checkout of the repository") == 2
    assert "of the paper and of studies are in a checkout" in answer.stderr


def test_help_names_every_command(capsys):
    assert cli.main(["--help"]) == 0
    shown = capsys.readouterr().out
    assert all(f"\n  {name} " in shown for name in cli.PARTS)
    assert cli.main([]) == cli.REFUSED


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        (["swep"], "did you mean sweep"),
        (["--hlp"], "did you mean --help"),
        (["fly", "tset1"], "did you mean test1"),
        (["fly", "nowhere/test1.toml"], "there is no file nowhere/test1.toml"),
        (["fly", "test1", "--overwite"], "did you mean --overwrite"),
        (["fly", "test1", "--backend", "rusty"], "did you mean rust"),
        (["figures", "fig6b"], "did you mean fig6"),
        (["sweep", "baseline_edges"], "baseline_edge"),
        (["view", "--prot", "1"], "did you mean --port"),
        (["train", "compact", "--datset", "x"], "did you mean --dataset"),
        (["study", "standing", "--hepl"], "did you mean --help"),
        (["sweep", "tuned", "--workers", "0"], "--workers: `0`; expected an integer ≥ 1"),
        (["sweep", "tuned", "--address", "somewhere"], "--address is somewhere; expected --cluster ray beside it"),
        (["robot", "import", "none.urdf", "--jet", "a:1", "--forward", "-x"], "none.urdf: No such file"),
        (["air", "--beta", "-90:nan:10"], "--beta is -90:nan:10; expected an angle, or FROM:TO:STEP"),
        (["robot", "waypoints", "bix"], "did you mean box"),
        (["data", "import-cfd", "--out", "nowhere.nc"], "one of the arguments --table --clone"),
        (["fly", "test1", "--all"], "argument --all: not allowed with argument NAME"),
        (["sweep", "paper_tests", "--all"], "argument --all: not allowed with argument NAME"),
    ],
)
def test_a_wrong_word_is_answered_with_what_was_meant(words, meant, capsys):
    try:
        status = cli.main(words)
    except SystemExit as ended:
        status = ended.code
    assert status == cli.REFUSED
    assert meant in capsys.readouterr().err


def test_ctrl_c_and_a_missing_package_are_one_line(monkeypatch, capsys):
    def interrupt(words):
        raise KeyboardInterrupt

    monkeypatch.setattr("jax_aero.commands.figures.main", interrupt)
    assert cli.main(["figures"]) == cli.INTERRUPTED
    assert capsys.readouterr().err == "interrupted\n"

    def lack_package(words):
        raise ModuleNotFoundError("No module named 'tqdm.auto'", name="tqdm.auto")

    monkeypatch.setattr("jax_aero.commands.fly.main", lack_package)
    assert cli.main(["fly", "test1"]) == cli.REFUSED
    assert capsys.readouterr().err.startswith("error: `fly` needs the package `tqdm` of the extra `figs`: ")


def test_what_a_terminal_would_obey_is_shown(monkeypatch, capsys):
    """Colours, titles, the beginning of the line, and the direction of writing."""

    def tell(words):
        print("\x1b[2J\x9b31m é\t1\n", end="")
        with progress_bar("flight", "a\rb", disable=False, delay=0.0) as show:
            show(1, 2)
        raise OSError(2, "No such file", "a\r\u202eb\x7f")

    monkeypatch.setattr("jax_aero.commands.figures.main", tell)
    assert cli.main(["figures"]) == cli.REFUSED
    said = capsys.readouterr()
    assert said.out == "\\x1b[2J\\x9b31m é\t1\n"
    assert said.err.endswith("error: a\\x0d\\u202eb\\x7f: No such file\n")
    assert "\ra\\x0db: " in said.err  # the bar itself goes back to the beginning


def begun(names):
    """Those with the first one's first letter."""
    return {name for name in names if name[0] == names[0][0]}


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("jax-aero ver", {"verify"}),
        ("jax-aero fly test1_p", {"test1_policy", "test1_published", "test1_published_observer"}),
        *((f"jax-aero study {name[:-1]}", {name}) for name in studies.names()[:1]),
        *((f"jax-aero study {name} {places.names(name)[0][:1]}", begun(places.names(name))) for name in CONFIGURED[:1]),
    ],
)
def test_tab_completes_commands_and_names(line, expected, tmp_path):
    answer = tmp_path / "words"
    environment = os.environ | {
        "_ARGCOMPLETE": "1",
        "COMP_LINE": line,
        "COMP_POINT": str(len(line)),
        "_ARGCOMPLETE_STDOUT_FILENAME": str(answer),
    }
    code = "import sys; from jax_aero.cli import main; sys.exit(main())"
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, env=environment, check=True, timeout=60)
    assert {word.strip() for word in answer.read_text().split("\v") if word.strip()} == expected


def test_a_configuration_is_found_by_name_and_by_path(tmp_path, monkeypatch):
    assert places.find("experiments", "test2") == ROOT / "configs/experiments/test2.toml"
    assert rust.load_config("test2") == rust.load_config(ROOT / "configs/experiments/test2.toml")
    with pytest.raises(ValueError, match="there is no `tset2` in configs/experiments; did you mean test2"):
        rust.load_config("tset2")
    monkeypatch.chdir(tmp_path)
    Path("mine.toml").touch()
    with pytest.raises(ValueError, match=r"there is no `mine` in .*; did you mean mine\.toml, which is here\?"):
        rust.load_config("mine")
    with pytest.raises(ValueError, match=r'is "test2"; expected a table, such as load_config'):
        rust.fly("test2")


@pytest.mark.parametrize("ending", ["TOML", "Toml", "toml"])
def test_a_name_of_a_file_may_have_capitals(ending, tmp_path, monkeypatch, capsys):
    """Of an experiment, of what it builds on, and of a controller, in this folder."""
    monkeypatch.chdir(tmp_path)
    Path(f"E.{ending}").write_text('base = "test2"\nsimulator = { duration = 0.05 }\n')
    Path(f"F.{ending}").write_text(f'base = "E.{ending}"\n')
    Path(f"C.{ending}").write_text(f'base = "{ROOT}/configs/control/baseline.toml"\n')
    assert rust.load_config(f"E.{ending}")["simulator"]["duration"] == 0.05
    assert rust.load_config(f"F.{ending}") == rust.load_config(f"E.{ending}")
    assert rust.load_controller(f"C.{ending}") == rust.load_controller("baseline")
    assert commands.main(["fly", f"E.{ending}", "--out", "out"]) == 0
    assert [path.name for path in Path("out").iterdir()] == ["E"]
    capsys.readouterr()


def test_a_base_that_is_no_text_is_refused_by_its_key(tmp_path):
    own = tmp_path / "own.toml"
    for value, key in (('base = ["a"]', "base"), ("base = 1", "base"), ('[wind]\nbase = ["a"]', r"wind\.base")):
        own.write_text(f"{value}\n" if value.startswith("base") else f'base = "test2"\n{value}\n')
        with pytest.raises(ValueError, match=rf"own\.toml: `{key}` is .*; expected the path of a TOML file$"):
            rust.load_config(own)
    outer = tmp_path / "outer.toml"
    outer.write_text('base = "own"\n')
    own.write_text('base = ["a"]\n')
    with pytest.raises(ValueError, match=r"own\.toml: `base` is") as refused:
        rust.load_config(outer)
    assert "outer" not in str(refused.value)


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-be", "utf-8-sig"])
def test_a_file_of_windows_is_read(encoding, tmp_path):
    """As its editors and shell write it: UTF-16 with a mark, in either order of bytes."""
    own = tmp_path / "own.toml"
    mark = "\ufeff" if encoding == "utf-16-be" else ""
    own.write_bytes(f'{mark}base = "test2"\ntitle = "größer"\n'.encode(encoding))
    assert rust.load_config(own)["title"] == "größer"


def test_a_file_anywhere_has_a_shipped_flight_as_its_base(tmp_path):
    own = tmp_path / "own.toml"
    own.write_text('base = "test2"\nwind = { base = "../wind/still.toml" }\n')
    assert rust.load_config(own) == rust.load_config("test2", {"wind": rust.load_config("no_wind")["wind"]})
    own.write_text('base = "tset2"\n')
    places_tried = f"there is no {tmp_path}/tset2.toml, and no {ROOT}/configs/experiments/tset2.toml"
    with pytest.raises(
        ValueError, match=f'`base` is "tset2.toml"; expected the path of a file that exists; {places_tried}'
    ):
        rust.load_config(own)


@pytest.mark.parametrize("is_clone", [True, False])
def test_results_go_to_the_clone_or_without_one_to_the_current_folder(is_clone, tmp_path, monkeypatch):
    for folder in ("here", "library/jax_aero", "clone/jax_aero", "clone/configs", "clone/rust"):
        (tmp_path / folder).mkdir(parents=True)
    (tmp_path / "library/jax_aero/configs").mkdir()
    (tmp_path / "clone/jax_aero/configs").symlink_to("../configs")
    package = tmp_path / ("clone" if is_clone else "library") / "jax_aero"
    shutil.copy(places.__file__, package)
    monkeypatch.chdir(tmp_path / "here")
    spec = importlib.util.spec_from_file_location("places_of_another", package / "places.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert tmp_path / ("clone/results" if is_clone else "here/results") == module.RESULTS


@pytest.mark.parametrize("size", [1, 100_000])
@pytest.mark.parametrize("words", [["--help"], ["fly", "--help"], ["fly"]])
def test_a_closed_pipe_ends_a_command_as_its_signal_would(words, size, monkeypatch, capsys):
    """A shell reports 128 and the number of the signal, whether a print or the last flush meets the closed pipe."""
    monkeypatch.setattr("jax_aero.commands.fly.__doc__", "x" * size)
    monkeypatch.setattr("jax_aero.results.study.print_titles", lambda _: exit_status(lambda: print("x" * size)))
    reader, writer = os.pipe()
    os.close(reader)
    with open(writer, "w", encoding="utf-8") as stream:  # noqa: PTH123 - a descriptor
        monkeypatch.setattr(sys, "stdout", stream)
        assert cli.main(words) == cli.CLOSED == 128 + signal.SIGPIPE
        stream.flush()  # as Python does at its exit
    assert capsys.readouterr().err == ""


def test_a_command_without_an_output_prints_nothing(monkeypatch):
    """As with `>&-`."""
    monkeypatch.setattr(sys, "stdout", None)
    assert cli.main(["--help"]) == 0


@pytest.mark.parametrize(("encoding", "shown"), [("ascii", "? m? ?\n"), ("utf-8", "α m² ?\n")])
def test_characters_that_the_output_cannot_show_are_replaced(encoding, shown, monkeypatch):
    """Among them bytes of a file's name that are not UTF-8."""
    stream = io.TextIOWrapper(io.BytesIO(), encoding=encoding)
    monkeypatch.setattr(sys, "stdout", stream)
    monkeypatch.setattr("jax_aero.commands.figures.main", lambda _: print("α m² \udc80"))
    assert cli.main(["figures"]) == 0
    assert stream.buffer.getvalue().decode(encoding) == shown


@pytest.mark.parametrize(("options", "shown"), [({}, ""), ({"disable": False, "mininterval": 0.0}, "x:  40%")])
def test_progress_is_shown_on_a_terminal_or_where_it_is_asked_for(options, shown, capsys):
    with progress_bar("tick", "x", delay=0.0, **options) as show:
        show(1, 5)
        show(2, 5)
    err = capsys.readouterr().err
    assert shown in err
    assert bool(shown) is bool(err)
