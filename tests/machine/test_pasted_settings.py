"""Settings pasted from web pages, mails and tables."""

from __future__ import annotations

import html
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.machine.test_firmware import FLUIDNC, KLIPPER, REPRAPFIRMWARE
from tests.machine.test_settings_dumps import FIRST, GRBL, INI, each, numbers, read
from threadline.errors import MachineError


def rows(form: str) -> Callable[[str], bytes]:
    """Return a table in which ``form`` is filled with each number and value of a dump."""

    def written(text: str) -> bytes:
        found = re.findall(r"\$(\d+)=([\d.]+)", text)
        return "".join(form.format(*one) + "\n" for one in found).encode()

    return written


PAGES: dict[str, Callable[[str], bytes]] = {
    "breaks": lambda text: f"<p>Mine:</p><p>{'<br />'.join(text.splitlines())}</p>".encode(),
    "break a line": each(lambda line: f"{html.escape(line)}<br>"),
    "list": each(lambda line: f"<li>{html.escape(line)}</li>"),
    "preformatted": lambda text: (
        f'<div class="cooked"><pre><code class="x">{html.escape(text)}</code></pre></div>'.encode()
    ),
    "quote of a page": each(lambda line: f"&gt; {html.escape(line)}&nbsp;"),
    "quote of a mail": lambda text: b"J wrote:\n" + each(lambda line: f"> > {line}")(text),
    "fence": lambda text: f"Mine:\n```\n{text}```\nThanks\n".encode(),
    "code a line": each(lambda line: f"- `{line}`"),
    "bold": each(lambda line: f"**{line}**  "),
    "bullets": each(lambda line: f"* {line}"),
    "board": lambda text: f"[quote][code]\n{text}[/code][/quote]\n".encode(),
    "commas": lambda text: re.sub(r"(?<=\d)\.(?=\d)", ",", text).encode(),
    "old Windows": lambda text: f"{text}Die Fr\u00e4se l\u00e4uft\n".encode("latin-1"),
}
TABLES = {
    "Markdown": rows("| ${0} | {1} | steps of X, step/mm |"),
    "tabs": rows("${0}\t{1}\tX-axis travel resolution, step/mm"),
    "columns": rows("${0}   {1}      some words"),
    "semicolons": rows("${0};{1};words, more"),
    "commas": rows("${0},{1},5 words"),
    "quoted": rows('"${0}","{1}","words, more"'),
    "colons": rows("${0}: {1}"),
    "JSON": rows('"${0}={1}",'),
    "blank": rows("$ {0} = {1}"),
    "cells": rows("<tr><td>${0}</td><td>{1}</td><td>words</td></tr>"),
}


@pytest.mark.parametrize("page", PAGES)
@pytest.mark.parametrize("text", [GRBL, FIRST], ids=["grbl", "marlin"])
def test_text_of_a_web_page_around_a_dump_is_ignored(text: str, page: str, tmp_path: Path) -> None:
    assert numbers(read(tmp_path, PAGES[page](text))) == numbers(read(tmp_path, text))


@pytest.mark.parametrize("table", TABLES)
def test_a_table_of_settings_is_a_dump(table: str, tmp_path: Path) -> None:
    assert numbers(read(tmp_path, TABLES[table](GRBL))) == numbers(read(tmp_path, GRBL))


def test_a_flattened_answer_of_marlin_is_read(tmp_path: Path) -> None:
    flat = " ".join(FIRST.splitlines())
    assert numbers(read(tmp_path, flat)) == numbers(read(tmp_path, FIRST))


def test_a_setting_of_a_page_names_its_line(tmp_path: Path) -> None:
    settings = read(tmp_path, "<p>Mine:</p>\n<p>" + "<br>".join(GRBL.splitlines()) + "</p>\n")
    assert str(settings.axes["X"].steps.place).endswith("settings.txt:2")


def test_decimal_commas_are_told(tmp_path: Path) -> None:
    (note,) = read(tmp_path, PAGES["commas"](GRBL)).notes
    assert "decimal commas" in note


@pytest.mark.parametrize("change", [("5000.000", "5,000.000"), ("5000.000", "5000,000")])
def test_commas_beside_points_are_refused(change: tuple[str, str], tmp_path: Path) -> None:
    """5,000 could be 5 or 5000."""
    with pytest.raises(MachineError, match=r"settings.txt:7"):
        read(tmp_path, GRBL.replace(*change))


FILES = {
    "printer.cfg": KLIPPER, "config.g": REPRAPFIRMWARE, "config.yaml": FLUIDNC, "mill.ini": INI,
}  # fmt: skip
MAILS: dict[str, Callable[[str], bytes]] = {
    "quote": each(lambda line: f"> {line}"),
    "stamped": each(lambda line: f"[12:31:07] {line}"),
    "numbered": lambda text: "".join(
        f"{number:4d}\t{line}\n" for number, line in enumerate(text.splitlines(), 1)
    ).encode(),
    "fence": lambda text: f"My file:\n```ini\n{text}```\nThanks: a lot\n".encode(),
    "preformatted": lambda text: f"<p>a: b</p><pre><code>{html.escape(text)}</code></pre>".encode(),
    "board": lambda text: f"[code]\n{text}[/code]\n".encode(),
    "indented": each(lambda line: f"    {line}"),
    "old Windows": lambda text: f"{text}{'#' if 'axes:' in text else ';'} D\u00fcse\n".encode(
        "latin-1"
    ),
}


@pytest.mark.parametrize("mail", MAILS)
@pytest.mark.parametrize("name", FILES)
def test_quoting_by_a_mail_around_a_file_is_ignored(name: str, mail: str, tmp_path: Path) -> None:
    """Quoted commands of RepRapFirmware were read as Marlin's, in other units."""
    plain = read(tmp_path, FILES[name], name)
    pasted = read(tmp_path, MAILS[mail](FILES[name]), name)
    assert pasted.firmware == plain.firmware and numbers(pasted) == numbers(plain)
    lines = {axis: motor.steps.place.line for axis, motor in plain.axes.items() if motor.steps}
    shift = 2 if mail == "fence" else mail == "board"
    assert lines == {axis: pasted.axes[axis].steps.place.line - shift for axis in lines}


MACRO = "[gcode_macro A]\ngcode:\n        G28\n        [stepper_a]\n"
MARGINS: dict[str, Callable[[str], bytes]] = {
    "all": each(lambda line: f"    {line}"),
    "keys": each(lambda line: line if line[:1] in (" ", "[") else f"  {line}"),
    "first": lambda text: f" {text}".encode(),
}


@pytest.mark.parametrize("margin", MARGINS)
def test_blanks_before_lines_of_klipper_change_nothing(margin: str, tmp_path: Path) -> None:
    """A line belongs to a value if it begins further right than the key of the value."""
    indented = MARGINS[margin](MACRO + KLIPPER)
    assert numbers(read(tmp_path, indented)) == numbers(read(tmp_path, KLIPPER))
