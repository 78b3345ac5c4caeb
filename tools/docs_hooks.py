"""What MkDocs calls while it builds the site of the documents (``mkdocs.yml`` names this file).

The page of the decisions lists every record under its title, so that nobody has to keep a list.
After the build no page may load anything from another computer: the site has to work without a
network. MkDocs' own check of links cannot see that, for such addresses come from a theme.
"""

from __future__ import annotations

import logging
import re
from pathlib import Path
from typing import Any

LOG = logging.getLogger("mkdocs.hooks.threadline")
"""Its warnings end a strict build, as MkDocs' own do."""
DECISIONS = "decisions/README.md"
LOADED = re.compile(
    r"""<(?:script|img|iframe|source)\b[^>]*\bsrc\s*=\s*["']?((?:https?:)?//[^"'\s>]+)"""
    r"""|<link\b(?=[^>]*\brel\s*=\s*["']?(?:stylesheet|preload|preconnect|icon))"""
    r"""[^>]*\bhref\s*=\s*["']?((?:https?:)?//[^"'\s>]+)"""
    r"""|@import\s+(?:url\()?["']?((?:https?:)?//[^"'\s)]+)"""
    r"""|url\(["']?((?:https?:)?//[^"'\s)]+)""",
    re.I,
)
"""What a browser loads with a page, without a click: scripts, pictures, styles and fonts."""


def on_page_markdown(markdown: str, page: Any, config: Any, **_: Any) -> str:
    """Return the text of a page; at the end of the page of the decisions, their list."""
    if page.file.src_uri != DECISIONS:
        return markdown
    records = sorted((Path(config["docs_dir"]) / "decisions").glob("0*.md"))
    return "\n".join([markdown, "", *map(entry, records), ""])


def entry(record: Path) -> str:
    """Return the line of a record in the list: its title, ``# 7. One table``, as a link."""
    title = record.read_text(encoding="utf-8").partition("\n")[0].removeprefix("# ")
    return f"- [{title.replace('. ', ': ', 1)}]({record.name})"


def on_post_build(config: Any, **_: Any) -> None:
    """Warn of everything that a page or a style would load from another computer."""
    site = Path(config["site_dir"])
    for file in sorted([*site.rglob("*.html"), *site.rglob("*.css")]):
        for found in LOADED.finditer(file.read_text(encoding="utf-8")):
            address = next(filter(None, found.groups()))
            LOG.warning("%s loads %s from another computer", file.relative_to(site), address)
