"""Messages on the page name fields of the page, and no options of a command line."""

from __future__ import annotations

import asyncio
import json
import re
from pathlib import Path

import pytest

from threadline.machine import load_machine
from threadline.panel.calculating import figures
from threadline.panel.control import FIELDS, Client, in_page_words
from threadline.panel.protocol import Answer, Figures, Said
from threadline.proof.options import Options
from threadline.proof.pipeline import NOMINAL, prove
from threadline.proof.recorded import warnings_of
from threadline.verdict import load_spec
from threadline.verdict.registry import MEASURES

ROOT = Path(__file__).parents[2]


def sent_to_client(*messages: Said | Answer | Figures) -> list[dict[str, object]]:
    """Return messages as a client gets them."""
    client = Client(1, "Anna")
    for message in messages:
        client.tell(message)
    texts = [asyncio.run(client.next_text(lambda: 0.0)) for _ in messages]
    return [json.loads(text or "") for text in texts]


def test_a_warning_of_a_proof_names_the_field_of_the_page() -> None:
    """The F of this program is above the normal feed; the warning names the field to change."""
    machine = load_machine("lathe-winder")
    program = ROOT / "examples" / "cone-dome-cylinder.prg"
    spec = load_spec(None, machine)
    proof = prove(program, machine, spec, Options(interpolation="linear"), trials=NOMINAL)
    assert any("Choose another feed with --feed" in one for one in warnings_of(proof))
    found = Figures(**{**figures(proof), "feed": None, "proof": "0" * 64})
    warnings = sent_to_client(found)[0]["warnings"]
    assert isinstance(warnings, list)
    assert any("Choose another feed with 'Feed', or" in one for one in warnings)
    assert not any("--" in one for one in warnings)


def test_refusals_name_fields_or_the_command_line() -> None:
    message, refused = sent_to_client(
        Said(text="--smoothing '9 ms' needs feed-forward. Give --feed-forward too.", wrong=True),
        Answer(number=1, ok=False, text="Leave --actual out; a--b and --- are no options."),
    )
    assert message["text"] == "'Smoothing' '9 ms' needs feed-forward. Give 'Loads follow' too."
    assert refused["text"] == (
        "Leave --actual of the command line out; a--b and --- are no options."
    )


@pytest.mark.parametrize("option", FIELDS)
def test_every_label_is_on_the_page(option: str) -> None:
    page = "".join(file.read_text("utf-8") for file in (ROOT / "web").glob("*.html"))
    page += "".join(file.read_text("utf-8") for file in (ROOT / "web" / "src").glob("*.ts"))
    label = FIELDS[option]
    assert re.search(rf"""[>"]\s*{label}\s*[<"]""", page)
    assert in_page_words(f"--{option}") == f"'{label}'"


def test_every_criterion_has_a_sentence_of_the_page() -> None:
    """The page describes each criterion in the words of the work, not by its name in a file."""
    text = (ROOT / "web" / "src" / "wording.ts").read_text("utf-8")
    sentences = text.partition("const SENTENCES")[2].partition("};")[0]
    known = set(re.findall(r"^  ([a-z_]+): ", sentences, re.MULTILINE))
    assert {name.removeprefix("planned_") for name in MEASURES} == known
