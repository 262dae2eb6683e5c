"""Drawn mistakes in the crate, and which of them its tests find: `python -m tests.tools.mutants` (an hour).

All mutants are compiled into one set of test binaries. A function with some has its body once more for each, and the
variable `MUTANT` chooses; a constant is another in every function of its file. What does not compile is drawn anew.
Each mutant runs the core's tests, then, where these pass, those of the packages that use it, until one fails. A
survivor is a missing test or a mistake that changes nothing: a person decides.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import re
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

HOME = Path(__file__).parents[2]
COPY = HOME / "target" / "mutants"
SOURCES = "rust/core/src"
LEFT_OUT = ("error.rs", "schema.rs", "float.rs", "robot/check.rs")
"""Refusals and the calling thread's rounding."""

PACKAGES = ("flight-core", "flight-io", "flight-sim")
LONGEST = 600.0
"""Duration after which a test binary counts as failed: a loop without an end [s]."""

SWITCH = """
/// Which mutant acts.
#[doc(hidden)]
pub mod mutant {
    static ACTS: std::sync::OnceLock<u32> = std::sync::OnceLock::new();
    /// Whether it is this one.
    #[must_use]
    pub fn is(number: u32) -> bool {
        *ACTS.get_or_init(|| std::env::var("MUTANT").ok().and_then(|text| text.parse().ok()).unwrap_or(0)) == number
    }
}
"""
PAIRS = "+ -, * /, += -=, *= /=, < >=, <= >, == !=, && ||, min max, sin cos, any all, is_some is_none"
PAIRS += ", least greatest, lower upper, true false"
OTHERS = {"x": "y", "y": "z", "z": "x", "abs": "sqrt"}
for pair in PAIRS.split(", "):
    one, other = pair.split()
    OTHERS |= {one: other, other: one}

SITE = re.compile(
    r"(?P<skip>//[^\n]*|\"(?:\\[\s\S]|[^\"\\])*\"|'(?:\\.|[^'\\])'|#\[[^\n]*\])"
    r"|(?<=[ \n])(?P<operator>[-+*/<>]=?|==|!=|&&|\|\|)(?= )"
    r"|(?P<sign>(?<=[ (\[,])[-!](?=[\w(]))"
    r"|\b(?P<guard>if )(?!let )"
    r"|\.(?P<method>min|max|sin|cos|abs|any|all|is_some|is_none)\("
    r"|\.(?P<axis>[xyz])\b(?!\()"
    r"|\b(?P<word>least|greatest|lower|upper|true|false)\b(?!\()"
    r"|(?<![\w.])(?P<number>\d[\d_]*\.\d[\d_]*(?:e-?\d+)?|\d+)(?![\w.]|\])"
    r"|(?<=\n)(?P<statement> +(?!let |return|break|continue|use |const )[a-z_][^\n{}=]*\([^\n{}]*\);)(?=\n)"
)
FUNCTION = re.compile(r"\n *(?:pub(?:\([^)]*\))? )?(?P<const>const )?(?:unsafe )?fn \w+")
CONSTANT = re.compile(r"\n(?:pub(?:\([^)]*\))? )?const (?P<name>[A-Z_]+): f64 = (?P<value>[^;]+);")


@dataclass(frozen=True)
class Mutant:
    """A change of the text of one or, of a constant, of several functions of a file."""

    file: str
    line: int
    before: str
    after: str
    bodies: tuple[tuple[int, int, str], ...]
    """Begin, end and new text of each function's body."""


def functions(text: str) -> Iterator[tuple[int, int]]:
    """Yield begin and end of the body of each function that is not in another one, without its braces."""
    blind = SITE.sub(lambda m: re.sub(r"[^\n]", " ", m[0]) if m["skip"] else m[0], text)
    blind = blind[: text.index("#[cfg(test)]")] if "#[cfg(test)]" in text else blind
    end = 0
    for found in FUNCTION.finditer(blind):
        if found.start() < end:
            continue
        place, depth = found.end(), 0
        while depth or blind[place] not in "{;":
            depth += {"(": 1, "[": 1, ")": -1, "]": -1}.get(blind[place], 0)
            place += 1
        if blind[place] == ";":
            continue
        begin, depth = place + 1, 1
        while depth:
            place += 1
            depth += {"{": 1, "}": -1}.get(blind[place], 0)
        end = place
        if not found["const"]:
            yield begin, end


def mutants_of(path: Path, rng: random.Random) -> Iterator[Mutant]:
    """Yield every mutant of a file, one for each place."""
    text, file = path.read_text(encoding="utf-8"), str(path.relative_to(HOME / SOURCES))
    bodies = list(functions(text))

    def mutant(place: int, length: int, after: str, chosen: Sequence[tuple[int, int, str]]) -> Mutant:
        return Mutant(file, text.count("\n", 0, place) + 1, text[place : place + length].strip(), after, tuple(chosen))

    for begin, end in bodies:
        for found in SITE.finditer(text, begin, end):
            kind = found.lastgroup
            if kind is None or kind == "skip":
                continue
            old = found[kind]
            if kind == "number":
                new = number(old, rng)
            else:
                guards = rng.choice(["if true || ", "if false && "])
                new = {"sign": " ", "statement": "    ", "guard": guards}.get(kind) or OTHERS[old]
            first = found.start(kind)
            body = text[begin:first] + new + text[first + len(old) : end]
            yield mutant(first, len(old), new.strip() or "(nothing)", [(begin, end, body)])
    for found in CONSTANT.finditer(text):
        factor, name = rng.choice(["0.1", "0.5", "2.0", "10.0"]), re.compile(rf"\b{found['name']}\b")
        changed = [
            (b, e, name.sub(f"({found['name']} * {factor})", text[b:e])) for b, e in bodies if name.search(text, b, e)
        ]
        if changed:
            yield mutant(found.start() + 1, len(found[0]) - 1, f"times {factor}", changed)


def number(old: str, rng: random.Random) -> str:
    """Return another number of the same type."""
    if "." not in old:
        return str(int(old.replace("_", "")) + (1 if old == "0" else rng.choice([-1, 1])))
    value = float(old.replace("_", ""))
    return "1.0" if value == 0.0 else repr(value * rng.choice([0.1, 0.5, 2.0, 10.0]))


def draw(seed: str, folder: str) -> list[Mutant]:
    """Return all mutants in random order."""
    rng, found = random.Random(seed), list[Mutant]()
    for path in sorted((HOME / SOURCES / folder).rglob("*.rs")):
        if not str(path).endswith(LEFT_OUT):
            found += mutants_of(path, rng)
    rng.shuffle(found)
    return found


def write(chosen: dict[int, Mutant]) -> dict[tuple[str, int], int]:
    """Write the sources with these mutants; return the mutant of each of their lines that has one."""
    of_line: dict[tuple[str, int], int] = {}
    for file in (str(path.relative_to(HOME / SOURCES)) for path in (HOME / SOURCES).rglob("*.rs")):
        text = (HOME / SOURCES / file).read_text(encoding="utf-8")
        of_body: dict[tuple[int, int], list[tuple[int, str]]] = {}
        for place, mutant in chosen.items():
            for begin, end, body in mutant.bodies if mutant.file == file else ():
                of_body.setdefault((begin, end), []).append((place, body))
        out, last, spans = "", 0, []
        for (begin, end), variants in sorted(of_body.items()):
            out += text[last:begin]
            for place, body in variants:
                first = out.count("\n") + 1
                out += f" if crate::mutant::is({place}) {{ {body} }} else "
                spans.append((first, out.count("\n") + 1, place))
            out, last = out + f"{{ {text[begin:end]} }}", end
        out += text[last:] + (SWITCH if file == "lib.rs" else "")
        to = COPY / SOURCES / file
        if not to.exists() or to.read_text(encoding="utf-8") != out:
            to.parent.mkdir(parents=True, exist_ok=True)
            to.write_text(out, encoding="utf-8")
        of_line |= {(file, line): place for first, end, place in spans for line in range(first, end + 1)}
    return of_line


def compile_tests(chosen: dict[int, Mutant]) -> dict[str, list[str]]:
    """Compile, without the mutants that do not; return the test binaries by package."""
    command = ["cargo", "test", "--locked", "--no-run", "--message-format=json", "--lib", "--test=main"]
    command += [f"-p{name}" for name in PACKAGES]
    target = os.environ.get("CARGO_TARGET_DIR", str(HOME / "target"))
    while True:
        of_line, binaries, wrong = write(chosen), dict[str, list[str]](), set[int]()
        env = os.environ | {"CARGO_TARGET_DIR": target, "RUSTFLAGS": "--cap-lints=warn", "CARGO_PROFILE_DEV_DEBUG": "0"}
        done = subprocess.run(command, cwd=COPY, env=env, capture_output=True, text=True)
        for line in done.stdout.splitlines():
            message = json.loads(line)
            if message["reason"] == "compiler-artifact" and message["profile"]["test"] and message["executable"]:
                name = message["package_id"].split("#")[0].rsplit("/", 1)[-1]
                binaries.setdefault(f"flight-{name}", []).append(message["executable"])
            if message["reason"] == "compiler-message" and message["message"]["level"] == "error":
                for span in message["message"]["spans"]:
                    file = span["file_name"].removeprefix(f"{SOURCES}/")
                    wrong |= {
                        of_line[file, row]
                        for row in range(span["line_start"], span["line_end"] + 1)
                        if (file, row) in of_line
                    }
        if done.returncode == 0:
            return binaries
        if not wrong:
            sys.exit(done.stdout[-2000:] + done.stderr[-4000:])
        print(f"  {len(wrong)} of {len(chosen)} do not compile", flush=True)
        for place in wrong:
            del chosen[place]


def failure(binary: str, package: str, mutant: int, only: Sequence[str] = ()) -> str | None:
    """Return the first test that fails, or what else ended the binary."""
    env = os.environ | {"MUTANT": str(mutant), "RUST_BACKTRACE": "0"}
    folder, said = COPY / "rust" / package.removeprefix("flight-"), COPY / "said.txt"
    with said.open("w", encoding="utf-8") as file:
        run = subprocess.Popen([binary, *only], cwd=folder, env=env, stdout=file, stderr=subprocess.STDOUT)
        begin, found = time.monotonic(), None
        while found is None:
            time.sleep(0.05)
            ended, text = run.poll() is not None, said.read_text(encoding="utf-8", errors="replace")
            if failed := re.search(r"^test (\S+) .*FAILED$", text, re.MULTILINE):
                found = failed[1]
            elif ended:
                found = f"status {run.returncode}" if run.returncode else ""
            elif time.monotonic() - begin > LONGEST:
                found = "no end"
        run.kill()
        run.wait()
    return found or None


def judge(binaries: dict[str, list[str]], place: int, mutant: Mutant, *, quickly: bool) -> str | None:
    """Return the test that finds a mutant: of those of its module's and folders' names, or of all."""
    near = [f"{part}::" for part in Path(mutant.file).with_suffix("").parts]
    for package in PACKAGES[:1] if quickly else PACKAGES:
        for binary in binaries[package]:
            if found := failure(binary, package, place, near if quickly else []):
                return f"{package} {found}"
    return None


def copy_if_changed(source: Path, to: Path) -> None:
    """Copy a file whose text is another one, so that cargo compiles nothing else again."""
    content = source.read_bytes()
    if not to.exists() or to.read_bytes() != content:
        to.parent.mkdir(parents=True, exist_ok=True)
        to.write_bytes(content)


def synchronise() -> None:
    """Copy what is compiled, without the sources that have mutants."""
    for path in (HOME / "rust").rglob("*"):
        place = path.relative_to(HOME)
        if path.is_file() and "node_modules" not in place.parts and not place.is_relative_to(SOURCES):
            copy_if_changed(path, COPY / place)
    for name in ("Cargo.toml", "Cargo.lock", "rustfmt.toml", "clippy.toml"):
        copy_if_changed(HOME / name, COPY / name)
    for name in ("configs", "tests", "jax_aero", "docs"):
        if not (COPY / name).exists():
            (COPY / name).symlink_to(HOME / name)


def main() -> None:
    """Draw, compile and judge; the table is printed, and written as `target/mutants.json`."""
    parser = argparse.ArgumentParser(description=__doc__)
    head = subprocess.run(
        ["git", "rev-parse", "HEAD"], cwd=HOME, capture_output=True, text=True, check=True
    ).stdout.strip()
    parser.add_argument("--seed", default=head, help="default: the commit")
    parser.add_argument("--count", type=int, default=60)
    parser.add_argument("--folder", default=".", help=f"part of {SOURCES}")
    parser.add_argument("--at", nargs="+", metavar="FILE:LINE", default=[], help="every mutant of these lines first")
    given = parser.parse_args()
    drawn = draw(given.seed, given.folder)
    named = [mutant for mutant in drawn if f"{mutant.file}:{mutant.line}" in given.at]
    synchronise()
    chosen = dict(enumerate([*named, *drawn[: 2 * given.count]], start=1))
    binaries = compile_tests(chosen)
    if wrong := [found for of in PACKAGES for each in binaries[of] if (found := failure(each, of, 0))]:
        sys.exit(f"without a mutant: {wrong}")
    first = sum(place <= len(named) for place in chosen)
    judged: dict[int, str | None] = {}
    for quickly in (True, False):
        for place, mutant in list(chosen.items())[: first + given.count]:
            if judged.get(place) is None:
                found = judged[place] = judge(binaries, place, mutant, quickly=quickly)
                if found or not quickly:
                    words = f"{mutant.file}:{mutant.line}  {mutant.before}  ->  {mutant.after}"
                    print(f"{place:3} {words}:  {found or 'SURVIVES'}", flush=True)
    names = ("file", "line", "before", "after")
    rows = [{n: getattr(chosen[at], n) for n in names} | {"found": found} for at, found in judged.items()]
    survived = sum(row["found"] is None for row in rows)
    (HOME / "target" / "mutants.json").write_text(json.dumps({"seed": given.seed, "mutants": rows}, indent=1) + "\n")
    print(f"{len(rows)} drawn by {given.seed}: {len(rows) - survived} found, {survived} survive")


if __name__ == "__main__":
    main()
