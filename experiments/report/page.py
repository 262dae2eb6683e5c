"""A page as a list of blocks, written as Markdown and as HTML with the same content.

Texts come from files too, so they are never HTML, and their links lead to files beside the page alone.
"""

from __future__ import annotations

import html
import re
from collections.abc import Sequence
from dataclasses import dataclass, field

STYLE = """
:root { color-scheme: light dark; --text: #1a1a1a; --page: #fff; --line: #d9d9d9; --code: #f2f2f2; --link: #0072b2; }
@media (prefers-color-scheme: dark) {
  :root { --text: #e0e0e0; --page: #16181d; --line: #3a3d44; --code: #262930; --link: #56b4e9; }
}
body { font: 15px/1.5 sans-serif; max-width: 62rem; margin: 2rem auto; padding: 0 1rem; }
body { color: var(--text); background: var(--page); overflow-wrap: break-word; }
a { color: var(--link); }
table { display: block; overflow-x: auto; border-collapse: collapse; margin: 1rem 0; font-size: 13px; }
th, td { border-bottom: 1px solid var(--line); padding: 0.3rem 0.6rem; text-align: left; vertical-align: top; }
th, td { min-width: 5rem; overflow-wrap: normal; }
th { border-bottom: 2px solid #7f7f7f; }
img { max-width: 100%; background: white; } figcaption { font-size: 13px; } figure { margin: 1.5rem 0; }
code { background: var(--code); padding: 0 0.2rem; }
"""


ELSEWHERE = r"\s*(?:[^/)]*:|[/\\])"
"""Beginning of a link that is no relative path."""


@dataclass(frozen=True)
class Heading:
    """A heading with a level from 1."""

    level: int
    text: str


@dataclass(frozen=True)
class Text:
    """A paragraph; `code`, **bold** and [links](path) as in Markdown."""

    text: str


@dataclass(frozen=True)
class Table:
    """A table: rows below their headings."""

    headings: Sequence[str]
    rows: Sequence[Sequence[str]]


@dataclass(frozen=True)
class Picture:
    """A figure beside the page, by its relative path."""

    path: str
    caption: str


Block = Heading | Text | Table | Picture


@dataclass
class Page:
    """A page: blocks in order."""

    title: str
    blocks: list[Block] = field(default_factory=list)

    def add(self, *blocks: Block) -> None:
        """Append blocks."""
        self.blocks.extend(blocks)

    def markdown(self) -> str:
        """Return the page as Markdown."""
        return "\n\n".join([f"# {self.title}", *(_markdown(block) for block in self.blocks)]) + "\n"

    def html(self) -> str:
        """Return the page as one HTML file, with pictures as separate files."""
        body = "\n".join([f"<h1>{html.escape(self.title)}</h1>", *(_html(block) for block in self.blocks)])
        return (
            f'<!DOCTYPE html>\n<html lang="en">\n<head><meta charset="utf-8">\n'
            f'<meta name="viewport" content="width=device-width">\n<title>{html.escape(self.title)}</title>\n'
            f"<style>{STYLE}</style></head>\n<body>\n{body}\n</body>\n</html>\n"
        )


def _markdown(block: Block) -> str:
    match block:
        case Heading(level, text):
            return f"{'#' * level} {_markdown_inline(text)}"
        case Text(text):
            return _markdown_inline(text)
        case Picture(path, caption):
            return f"![{_markdown_inline(caption)}]({path})\n\n*{_markdown_inline(caption)}*"
        case Table(headings, rows):
            cells = [headings, ["---"] * len(headings), *rows]
            lines = ([_markdown_inline(cell).replace("|", "\\|") for cell in row] for row in cells)
            return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _markdown_inline(text: str) -> str:
    text = " ".join(text.split())
    text = re.sub(rf"\]\((?={ELSEWHERE})", "] (", text)
    # Within code, `<` is a letter. Other backticks than pairs of single ones may mean something else to a reader.
    parts = [text] if "``" in text or "\\`" in text or text.count("`") % 2 else text.split("`")
    return "`".join(part if index % 2 else part.replace("<", "&lt;") for index, part in enumerate(parts))


def _html(block: Block) -> str:
    match block:
        case Heading(level, text):
            return f"<h{level}>{_inline(text)}</h{level}>"
        case Text(text):
            return f"<p>{_inline(text)}</p>"
        case Picture(path, caption):
            shown, said = html.escape(path), _inline(caption)
            picture = f'<a href="{shown}"><img src="{shown}" alt="{html.escape(caption)}"></a>'  # for a closer look
            return f"<figure>{picture}<figcaption>{said}</figcaption></figure>"
        case Table(headings, rows):
            head = "".join(f"<th>{_inline(cell)}</th>" for cell in headings)
            body = "\n".join("<tr>" + "".join(f"<td>{_inline(cell)}</td>" for cell in row) + "</tr>" for row in rows)
            return f"<table>\n<thead><tr>{head}</tr></thead>\n<tbody>\n{body}\n</tbody>\n</table>"


def _inline(text: str) -> str:
    text = html.escape(text)
    text = re.sub(r"`([^`]+)`", r"<code>\1</code>", text)
    text = re.sub(r"\*\*([^*]+)\*\*", r"<b>\1</b>", text)
    text = re.sub(r"\*(\w[^*]*\w)\*", r"<i>\1</i>", text)
    return re.sub(rf"\[([^\]]+)\]\((?!{ELSEWHERE})([^)\s]+)\)", r'<a href="\2">\1</a>', text)
