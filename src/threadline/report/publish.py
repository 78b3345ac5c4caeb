"""Files of a document: one self-contained HTML page, a PDF, and every figure as SVG and PNG."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from markupsafe import Markup

from threadline.base.writing import remove_with, staging_folder, together
from threadline.report.document import Document, failing
from threadline.report.style import headed, laid_out

_PNG_DPI = 160
_PNG: dict[str, Any] = {"compress_level": 2}
"""Compression level of PNG files. The usual 6 takes twice as long and saves 7 %."""


def write_document(document: Document, folder: Path, stem: str) -> Path:
    """Write the document into ``folder`` and return the path of its HTML page.

    The files appear together when all are complete; a failure leaves neither files nor a new
    folder. The figures of an earlier page with the same name are removed.

    Raises
    ------
    OptionError, OSError
        If the folder cannot be written.
    """
    # Imported late: their libraries are heavy.
    from threadline.report.document import svg_text, without_head
    from threadline.report.pdf import write_pdf

    document = document.shown()
    with together():
        old_files = _figure_files(folder, stem)
        with staging_folder(folder) as temporary, laid_out(document.figures.values()):
            svgs = {}
            for name, figure in document.figures.items():
                # A figure file has lines with job, machine and verdict above the figure.
                with headed(figure, _head(document)) as area:
                    # Not with_suffix: it would cut the feed in "auto-0.6m-per-s".
                    figure_stem = f"{temporary / stem}-{name}"
                    svg = svg_text(figure, area)
                    Path(f"{figure_stem}.svg").write_text(svg, encoding="utf-8")
                    svgs[name] = without_head(svg, area.height - figure.get_figheight())
                    figure.savefig(
                        f"{figure_stem}.png", dpi=_PNG_DPI, metadata={"Software": None},
                        bbox_inches=area, pil_kwargs=_PNG,
                    )  # fmt: skip
            for name, content in document.beside.items():
                Path(f"{temporary / stem}-{name}").write_bytes(content)
            page = temporary / f"{stem}.html"
            page.write_text(html_page(document, svgs), encoding="utf-8")
            write_pdf(document, temporary / f"{stem}.pdf")
            new_files = {file.name for file in temporary.iterdir()}
        for name in old_files - new_files:
            remove_with(folder / name)
    return folder / f"{stem}.html"


def _head(document: Document) -> list[str]:
    """Return the lines above a figure file: title and verdicts."""
    title = ": ".join(filter(None, (document.title, document.subtitle)))
    return [title, *(text for text, _ in document.verdicts)]


def _figure_files(folder: Path, stem: str) -> set[str]:
    """Return the names of the figure files in ``folder`` that belong to its page."""
    try:
        page = (folder / f"{stem}.html").read_text(encoding="utf-8")
    except (OSError, ValueError):
        return set()
    names = re.findall(r'<figure id="([A-Za-z0-9_-]+)">', page)
    files = {f"{stem}-{name}.{ending}" for name in names for ending in ("svg", "png", "glb")}
    return {name for name in files if (folder / name).is_file()}


def html_page(document: Document, svgs: Mapping[str, str]) -> str:
    """Return the text of one self-contained page; ``svgs`` holds the figures, by name."""
    from jinja2 import Environment, PackageLoader, StrictUndefined  # slow to import

    environment = Environment(
        loader=PackageLoader("threadline.report"), autoescape=True, undefined=StrictUndefined
    )
    environment.filters["css_string"] = css_string
    environment.filters["failing"] = failing
    inline = []
    for index, (name, svg) in enumerate(svgs.items()):
        body = svg[svg.index("<svg") :]
        # Identifiers must be unique once several figures share one page.
        body = re.sub(r'\bid="', f'id="f{index}-', body)
        body = re.sub(r'(xlink:href="|href="|url\()#', rf"\1#f{index}-", body)
        inline.append(
            {"name": name, "svg": Markup(body), "caption": document.captions.get(name, "")}  # noqa: S704 - our own figure
        )
    return environment.get_template("report.html").render(document=document, figures=inline)


def css_string(text: str) -> Markup:
    r"""Return ``text`` quoted as a CSS string, so that it cannot end the string or the style sheet.

    >>> print(css_string('IN SPEC (96 % "used")</style>'))
    "IN SPEC (96 % \22 used\22 )\3c /style\3e "
    """
    return Markup('"{}"').format(Markup(re.sub(r'[\\"<>&\x00-\x1f\x7f]', _css_escape, text)))  # noqa: S704


def _css_escape(found: re.Match[str]) -> str:
    return f"\\{ord(found[0]):x} "
