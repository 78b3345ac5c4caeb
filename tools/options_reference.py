"""Write what is made from the table of options: the reference page, the types, the panel's fields.

``python -m tools.options_reference`` writes ``docs/options.md``, ``src/threadline/__init__.pyi``
and the option fields of ``web/index.html``; a test compares the files with what this writes.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from html import escape
from pathlib import Path
from typing import Any

from threadline import face
from threadline.cli.lazy import COMMANDS, LazyGroup
from threadline.panel.control import in_page_words
from threadline.proof.option_form import Door, Group, Option, Type
from threadline.proof.option_table import PYTHON_VERBS, TABLE, options_for, python_name
from threadline.proof.verbs_without import reasons

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "options.md"
STUB = ROOT / "src" / "threadline" / "__init__.pyi"
PANEL = ROOT / "web" / "index.html"
_KINDS = {
    "ticks": "axes with control loops or steppers",
    "switches": "on/off machines",
    "steps": "embroidery machines",
}
_HEAD = """# Options

Every option of planning, judging and searching is declared once, in
`src/threadline/proof/option_table.py`. The command line, Python (`import threadline as tl`), the
panel, recordings, proofs and this page read these declarations. After a change of the declarations,
`python -m tools.options_reference` writes this page, the types of the Python functions and the
fields of the panel again.

Type a value with its unit, in quotes if it contains a blank: `--feed "36 mm/s"`, in Python
`feed="36 mm/s"`. In each table, `value` names the SI unit to which the value is converted, and
`panel` among the commands means that the operator's panel has the option. If an option has another
meaning or default with one command, a line that begins with the command says so. A row that begins
with *not* says why a command does not take the option, and what to use instead.

"""


def page() -> str:
    """Return the reference page."""
    parts = [_HEAD]
    for group in Group:
        parts.append(f"## {group.value}\n\n")
        parts += [_section(one) for one in TABLE if one.group is group]
    parts.append(
        "## Options of one command alone\n\nThese options say what one command writes, draws or "
        "executes. Other commands do not have them, or give them another meaning.\n\n"
    )
    parts += [_of_command(name) for name in COMMANDS]
    return "".join(parts).rstrip() + "\n"


def _section(one: Option) -> str:
    short = f", `-{one.short}`" if one.short else ""
    on_line = Door.LINE in one.doors
    title = f"`{one.typed}`{short}" if on_line else f"`{one.word}`"
    rows = [("value", _value(one)), ("default", _default(one)), ("commands", ", ".join(one.verbs))]
    python = [verb for verb in PYTHON_VERBS if one in options_for(verb, Door.PYTHON)]
    if python:
        functions = ", ".join(f"`tl.{python_name(verb)}`" for verb in python)
        rows.append(("Python", f"`{one.word}` of {functions}"))
    if one.group is Group.PLAN:
        rows.append(("machines", "; ".join(_KINDS[kind] for kind in one.kinds)))
    if one.recorded is not None:
        rows.append(("recordings and proofs", f"`{one.recorded.key}`"))
    for without in reasons(one.name):
        rows.append((f"not {', '.join(without.verbs)}", f"{without.why}. {without.instead}"))
    table = "".join(f"| {name} | {_cell(text)} |\n" for name, text in rows)
    texts = [one.help, *(f"`{verb}`: {text}" for verb, text in one.helps.items())]
    return f"### {title}\n\n" + "\n\n".join(texts) + f"\n\n| | |\n|---|---|\n{table}\n"


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


def _value(one: Option) -> str:
    if one.choices:
        return ", ".join(f"`{text}`" for text in one.choices)
    if one.type is Type.COUNT:
        return f"{one.type.value}, {one.least} to {one.most}"
    return f"{one.type.value}, {one.unit}" if one.unit else one.type.value


def _default(one: Option) -> str:
    if one.type is Type.FLAG:
        return "off"
    others = (f"of {verb} `{text}`" for verb, text in one.defaults.items())
    return ", ".join(("none" if one.default is None else f"`{one.default}`", *others))


def _of_command(name: str) -> str:
    """Return the options of a command that the table does not have."""
    group = LazyGroup(name="threadline")
    table = {one.word for one in options_for(name)}
    rows = []
    for one in group.get_command(None, name).params:
        if one.param_type_name == "option" and one.name not in {*table, "help"}:
            rows.append(
                f"| {', '.join(f'`{typed}`' for typed in one.opts)} | {_cell(one.help)} |\n"
            )
    if not rows:
        return ""
    return f"### threadline {name}\n\n| option | |\n|---|---|\n{''.join(rows)}\n"


_STUB_HEAD = '''"""Types of the functions, written by python -m tools.options_reference."""

from collections.abc import Sequence
from typing import Literal

from threadline.face import analyse as analyse
from threadline.face import control as control
from threadline.face import fit as fit
from threadline.face import load_machine as load_machine
from threadline.face import measure as measure
from threadline.face import retime as retime
from threadline.face import shaper as shaper
from threadline.face import trim as trim
from threadline.face import tune as tune
from threadline.face import wind as wind
from threadline.face.answers import Answer, FastestResult, PathLike, Proved
from threadline.face.running import Ran
from threadline.files.formats import Written
from threadline.machine import Machine
from threadline.readback.equal import Equality
from threadline.search import Comparison
from threadline.search.design import DesignResult
from threadline.search.learned_job import LearnedJob, LearnedRuns
from threadline.search.machine_yield import Yield
from threadline.verdict import Spec

__version__: str
__all__ = [
{names}]
'''


def stub() -> str:
    """Return the types of the package's functions, with every option by name."""
    names = "".join(f'    "{name}",\n' for name in face.__all__)
    verbs = [getattr(face, name) for name in face.__all__ if hasattr(getattr(face, name), "words")]
    return _STUB_HEAD.format(names=names) + "\n" + "".join(map(_declared, verbs))


def _declared(verb: Callable[..., Any]) -> str:
    signature = inspect.signature(verb)
    lines, keyword_only = [], False
    for one in signature.parameters.values():
        if one.kind is one.KEYWORD_ONLY and not keyword_only:
            lines.append("    *,\n")
            keyword_only = True
        default = "" if one.default is one.empty else f" = {_text(one.default)}"
        lines.append(f"    {one.name}: {one.annotation}{default},\n")
    return f"def {verb.__name__}(\n{''.join(lines)}) -> {signature.return_annotation}: ...\n"


def _text(value: object) -> str:
    if isinstance(value, tuple):
        return "..." if value else "()"
    return f'"{value}"' if isinstance(value, str) else repr(value)


_BEGIN = "<!-- from the table of options: python -m tools.options_reference -->"
_END = "<!-- end of the table of options -->"


def with_fields(html: str) -> str:
    """Return the page of the panel with the fields that the table declares."""
    before, _, rest = html.partition(_BEGIN)
    _, _, after = rest.partition(_END)
    rows = "".join(
        f"            {_field(one)}\n"
        for one in options_for("panel", Door.PANEL)
        if one.label and one.name not in _APART
    )
    return f"{before}{_BEGIN}\n{rows}            {_END}{after}"


_APART = ("interpolation", "feed", "offset")
"""Options whose fields stand elsewhere on the page, with more beside them."""


def _field(one: Option) -> str:
    """Return the field of an option with its help below it."""
    kind = 'type="checkbox"' if one.type is Type.FLAG else ""
    shown = "" if one.type is Type.FLAG else f'placeholder="{escape(one.placeholder, quote=False)}"'
    return (
        f'<p class="option" data-option="{one.name}"><label for="{one.name}">{one.label}</label> '
        f'<input id="{one.name}" {kind}{shown} aria-describedby="{one.name}-told" />\n'
        f'              <small id="{one.name}-told">{escape(in_page_words(one.help))}</small></p>'
    )


def files() -> Mapping[Path, str]:
    """Return every file that is made from the table, with its content."""
    return {PAGE: page(), STUB: stub(), PANEL: with_fields(PANEL.read_text(encoding="utf-8"))}


if __name__ == "__main__":
    for file, content in files().items():
        file.write_text(content, encoding="utf-8")
        print(file.relative_to(ROOT))
