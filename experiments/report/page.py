"""A page as a list of blocks, written as Markdown and as HTML with the same content.

Texts come from files too, so they are never HTML, and their links lead to files beside the page alone, or within it.
"""

from __future__ import annotations

import base64
import html
import io
import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

STYLE = """
:root { color-scheme: light dark; --text: #1a1a1a; --page: #fff; --line: #d9d9d9; --code: #f2f2f2; --link: #0072b2; }
:root { --quiet: #5f6368; --good: #1a6b38; --bad: #a3330c; }
@media (prefers-color-scheme: dark) {
  :root { --text: #e0e0e0; --page: #16181d; --line: #3a3d44; --code: #262930; --link: #56b4e9; }
  :root { --quiet: #9aa0a6; --good: #7bd389; --bad: #ff9e7a; }
}
html { -webkit-text-size-adjust: 100%; }
body { font: 16px/1.5 system-ui, sans-serif; max-width: 70rem; margin: 2rem auto; padding: 0 1rem; }
body { color: var(--text); background: var(--page); overflow-wrap: break-word; }
p, nav, figcaption { max-width: 48rem; }
h1, h2, h3 { line-height: 1.25; }
h2 { margin-top: 2.5rem; padding-top: 0.5rem; border-top: 1px solid var(--line); }
a { color: var(--link); }
nav a { margin-right: 1rem; display: inline-block; }
div.table { overflow-x: auto; margin: 1rem 0; }
table { border-collapse: collapse; font-size: 14px; width: 100%; font-variant-numeric: tabular-nums; }
th, td { border-bottom: 1px solid var(--line); padding: 0.35rem 0.6rem; text-align: left; vertical-align: top; }
th, td { min-width: 4.5rem; max-width: 20rem; overflow-wrap: break-word; }
th { border-bottom: 2px solid #7f7f7f; vertical-align: bottom; }
td code { overflow-wrap: anywhere; }
b.good { color: var(--good); } b.bad { color: var(--bad); } b.open { color: var(--quiet); }
figure { margin: 1.5rem 0; } figcaption { font-size: 14px; color: var(--quiet); margin-top: 0.4rem; }
img { max-width: min(100%, 56rem); background: white; padding: 0.5rem; box-sizing: border-box; border-radius: 4px; }
code { background: var(--code); padding: 0 0.2rem; border-radius: 3px; font-size: 0.9em; }
@media (max-width: 40rem) {
  div.table thead { display: none; }
  div.table table, div.table tbody, div.table tr, div.table td { display: block; }
  div.table tr { padding: 0.6rem 0; border-bottom: 1px solid var(--line); }
  div.table td { border: 0; padding: 0.1rem 0; max-width: none; }
  div.table td:empty { display: none; }
  div.table td::before { content: attr(data-of) ": "; color: var(--quiet); }
}
@media print { a { color: inherit; } figure, tr { break-inside: avoid; } }
"""


ELSEWHERE = r"\s*(?:[^/)]*:|[/\\])"
"""Beginning of a link that is no relative path."""


def literal(text: str) -> str:
    """Return a text of a file as one of a block that is shown as it stands, whatever its characters mean in Markdown.

    >>> literal("[a](b) `c` & **d**")
    '&#91;a&#93;(b) &#96;c&#96; &#38; &#42;&#42;d&#42;&#42;'
    """
    return re.sub(r"[\\`*\[\]<>|&~!]|\b_|_\b", lambda found: f"&#{ord(found[0])};", " ".join(text.split()))


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
class Mark:
    """A cell that is read first: bold, and on the page in the colour of its tone."""

    text: str
    tone: Literal["good", "bad", "open"]


@dataclass(frozen=True)
class Table:
    """A table: rows below their headings."""

    headings: Sequence[str]
    rows: Sequence[Sequence[str | Mark]]


@dataclass(frozen=True)
class Contents:
    """Links to the page's headings of level 2."""


@dataclass(frozen=True)
class Picture:
    """A figure beside the page, by its relative path."""

    path: str
    caption: str


Block = Heading | Text | Table | Picture | Contents


@dataclass
class Page:
    """A page: blocks in order."""

    title: str
    blocks: list[Block] = field(default_factory=list)

    def add(self, *blocks: Block) -> None:
        """Append blocks."""
        self.blocks.extend(blocks)

    def markdown(self) -> str:
        """Return the page as Markdown, which shows the pictures that lie beside it; a list of its parts is left out."""
        shown = [_markdown(block) for block in self.blocks if not isinstance(block, Contents)]
        return "\n\n".join([f"# {_markdown_inline(self.title)}", *shown]) + "\n"

    def html(self, folder: Path) -> str:
        """Return the page as one HTML file that holds its pictures, which lie in `folder`."""
        pictures = {block.path for block in self.blocks if isinstance(block, Picture)}
        parts = [block.text for block in self.blocks if isinstance(block, Heading) and block.level == 2]
        body = "\n".join(_html(block, folder, pictures, parts) for block in self.blocks)
        return (
            f'<!DOCTYPE html>\n<html lang="en">\n<head><meta charset="utf-8">\n'
            f'<meta name="viewport" content="width=device-width, initial-scale=1">\n'
            f"<title>{html.escape(self.title)}</title>\n<style>{STYLE}</style></head>\n"
            f"<body>\n<h1>{html.escape(self.title)}</h1>\n{body}\n</body>\n</html>\n"
        )


def _markdown(block: Heading | Text | Table | Picture) -> str:
    match block:
        case Heading(level, text):
            return f"{'#' * level} {_markdown_inline(text)}"
        case Text(text):
            return _markdown_inline(text)
        case Picture(path, caption):
            return f"![{_markdown_inline(caption)}]({path})\n\n*{_markdown_inline(caption)}*"
        case Table(headings, rows):
            cells = [headings, ["---"] * len(headings), *rows]
            texts = ([f"**{cell.text}**" if isinstance(cell, Mark) else cell for cell in row] for row in cells)
            lines = ([_markdown_inline(text).replace("|", "\\|") for text in row] for row in texts)
            return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _markdown_inline(text: str) -> str:
    text = " ".join(text.split())
    text = re.sub(rf"\]\((?={ELSEWHERE})", "] (", text)
    # Within code, `<` is a letter. Other backticks than pairs of single ones may mean something else to a reader.
    parts = [text] if "``" in text or "\\`" in text or text.count("`") % 2 else text.split("`")
    return "`".join(part if index % 2 else part.replace("<", "&lt;") for index, part in enumerate(parts))


def _html(block: Block, folder: Path, pictures: Collection[str], parts: Sequence[str]) -> str:
    def inline(text: str) -> str:
        return _inline(text, pictures)

    def cell(content: str | Mark) -> str:
        return f'<b class="{content.tone}">{inline(content.text)}</b>' if isinstance(content, Mark) else inline(content)

    match block:
        case Heading(level, text):
            return f'<h{level} id="{_anchor(text)}">{inline(text)}</h{level}>'
        case Text(text):
            return f"<p>{inline(text)}</p>"
        case Contents():
            links = (f'<a href="#{_anchor(part)}">{inline(part)}</a>' for part in parts)
            return f"<nav>{' '.join(links)}</nav>"
        case Picture(path, caption):
            shown, said = (
                f'<img src="{_embed(folder / path)}" alt="{html.escape(html.unescape(caption))}">',
                inline(caption),
            )
            return f'<figure id="{_anchor(path)}">{shown}<figcaption>{said}</figcaption></figure>'
        case Table(headings, rows):
            head = "".join(f"<th>{inline(heading)}</th>" for heading in headings)
            starts = [f'<td data-of="{html.escape(heading)}">' for heading in headings]
            lines = ("".join(f"{td}{cell(part)}</td>" for td, part in zip(starts, row, strict=True)) for row in rows)
            body = "\n".join(f"<tr>{line}</tr>" for line in lines)
            whole = f"<table>\n<thead><tr>{head}</tr></thead>\n<tbody>\n{body}\n</tbody>\n</table>"
            return f'<div class="table">{whole}</div>'


def _anchor(text: str) -> str:
    return re.sub(r"\W+", "-", text).strip("-").lower()


def _embed(path: Path) -> str:
    """Return a picture as the address of its own data: WebP without loss, a third of the size of PNG."""
    from PIL import Image

    data = io.BytesIO()
    with Image.open(path) as picture:
        picture.save(data, "WEBP", lossless=True, method=1)
    return f"data:image/webp;base64,{base64.b64encode(data.getvalue()).decode()}"


def _inline(text: str, pictures: Collection[str]) -> str:
    """Return a text as HTML; a link leads to a picture of the page, since nothing else is sent with it."""

    def link(found: re.Match[str]) -> str:
        shown, path = found.groups()
        return f'<a href="#{_anchor(path)}">{shown}</a>' if html.unescape(path) in pictures else shown

    text = re.sub(r"&amp;(#\d+;)", r"&\1", html.escape(text))  # characters of `literal` stay as they are
    text = re.sub(r"`([^`]+)`", r"<code>\1</code>", text)
    text = re.sub(r"\*\*([^*]+)\*\*", r"<b>\1</b>", text)
    text = re.sub(r"\*(\w[^*]*\w)\*", r"<i>\1</i>", text)
    return re.sub(rf"\[([^\]]+)\]\((?!{ELSEWHERE})([^)\s]+)\)", link, text)
