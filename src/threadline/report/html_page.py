"""A document as one self-contained HTML page, for the screen and for the printer."""

from __future__ import annotations

import re
from collections.abc import Mapping

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from threadline.report.document import Document, failing


def html_page(document: Document, svgs: Mapping[str, str]) -> str:
    """Return the text of the page; ``svgs`` holds the figures as SVG, by name."""
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
