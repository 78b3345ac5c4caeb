"""The panel against its own schemas: all allowed messages, and wrong ones.

The schema is read from the documentation, not from the program.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pydantic import TypeAdapter
from starlette.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

from tests.panel.bench import LOCAL, PROGRAM, Operator, operator, served
from tests.panel.from_schema import values
from threadline.panel import drawings, drawn
from threadline.panel.protocol import ServerMessage

SCHEMA = json.loads((Path(__file__).parents[2] / "docs" / "panel-protocol.json").read_text("utf-8"))
FROM_CLIENT, HTTP = SCHEMA["from_client"], SCHEMA["http"]
ANSWERS: TypeAdapter[Any] = TypeAdapter(ServerMessage)
FUZZED = settings(
    max_examples=80,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)


async def answer_here(*words: str, sent: bytes, longest_s: float) -> tuple[int, bytes, bytes]:
    """Stand-in for the process that reads a drawing; ``test_drawn.py`` starts such processes."""
    if "\0" in words[-1]:
        raise ValueError("embedded null byte")  # no process accepts such an argument
    status, message = drawings.answered(words[-2], words[-1], sent)
    return status, message, message


@pytest.fixture(scope="module", autouse=True)
def drawings_are_read_here() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(drawn, "answer_of", answer_here)
        yield


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestClient]:
    folder = tmp_path_factory.mktemp("fuzzed")
    (folder / "there.prg").write_text(PROGRAM, "utf-8")
    with served(folder) as found:
        with operator(found) as anna:
            anna.see("disabled")  # the machine has started
        yield found


def messages(*but: str) -> st.SearchStrategy[Any]:
    own = {"hello": "Hello", "stop": "Stop", "control": "Control", "alive": "Alive", "act": "Act"}
    kinds = [name for kind, name in own.items() if kind not in but]
    assert set(own.values()) <= set(FROM_CLIENT["$defs"])
    return st.one_of([values(FROM_CLIENT["$defs"][name], FROM_CLIENT) for name in kinds])


def heard(anna: Operator, count: int = 3) -> None:
    """Read a few messages; each must be a message of the protocol."""
    for _ in range(count):
        ANSWERS.validate_python(anna.hear())


@FUZZED
@given(st.lists(messages("hello"), min_size=1, max_size=5))
def test_every_message_of_the_schema_is_taken_and_moves_nothing_without_a_lease(
    client: TestClient, text: list[Any]
) -> None:
    with operator(client) as eve:
        for message in text:
            eve.socket.send_text(json.dumps(message))
        heard(eve, 4)
        eve.catch_up(client)
        assert eve.state["state"] == "disabled"
        assert all(at["commanded"] in (None, 0.0) for at in eve.state["axes"].values())


@FUZZED
@given(values(FROM_CLIENT["$defs"]["Act"]["properties"]["command"], FROM_CLIENT))
def test_every_command_of_one_in_control_is_answered_once(
    client: TestClient, command: dict[str, Any]
) -> None:
    """The machine is disabled; commands that start a process have tests of their own."""
    if command["what"] in {"reconnect", "calculate"}:
        return
    with operator(client) as anna:
        anna.take()
        anna.catch_up(client)
        words = {name: word for name, word in command.items() if name != "what"}
        anna.act(command["what"], **words)
        heard(anna)
        assert anna.see("disabled", "enabled", "homing", "idle", "jogging")
        anna.say(type="stop")
        anna.act("disable")


@st.composite
def spoiled(draw: st.DrawFn) -> Any:
    """A message of the schema with a missing field, or a field of another kind or name."""
    message = draw(messages())
    how = draw(st.sampled_from(["less", "more", "other"]))
    needs = sorted(set(message) & {"type", "lease", "seen", "number", "command", "word", "name"})
    if message["type"] == "stop" and how == "less":
        needs = ["type"]  # its number may be left out
    name = draw(st.sampled_from(needs))
    if how == "less":
        del message[name]
    elif how == "more":
        message["unknown"] = 1
    else:
        message[name] = [message[name]]
    return message


@FUZZED
@given(spoiled())
def test_message_outside_the_schema_ends_the_connection(client: TestClient, message: Any) -> None:
    with operator(client) as eve:
        eve.socket.send_text(json.dumps(message))
        with pytest.raises(WebSocketDisconnect) as ended:
            eve.until("never")
        assert ended.value.code == 4400


REQUESTS = [(path, method) for path, item in HTTP["paths"].items() for method in item]


@pytest.mark.parametrize(("path", "method"), REQUESTS)
@settings(FUZZED, max_examples=40)
@given(data=st.data())
def test_every_request_is_answered_as_it_is_described(
    client: TestClient, path: str, method: str, data: st.DataObject
) -> None:
    """No answer is an error of the server, and the description has every answer."""
    described = HTTP["paths"][path][method]
    filled = path
    for one in described.get("parameters", ()):
        if one["in"] == "path":
            body = data.draw(values(one["schema"], HTTP) | st.text(max_size=12))
            filled = filled.replace("{" + one["name"] + "}", quoted(body))
    headers = {**LOCAL, "x-lease": data.draw(st.sampled_from(["", "guess"]))}
    content = data.draw(st.binary(max_size=40)) if method in {"put", "post"} else None
    query = {
        one["name"]: data.draw(st.sampled_from(["", "a.dxf", "a.svg"]) | st.text(max_size=8))
        for one in described.get("parameters", ())
        if one["in"] == "query"
    }
    answer = client.request(
        method.upper(), filled, headers=headers, content=content, params=query or None
    )
    known = {int(code) for code in described["responses"]}
    # A name with a slash, or an empty one, is another path: a path of the page, or none.
    assert answer.status_code in known | {404, 405, 307}, (filled, answer.text)
    assert client.get("/api/state").json()["state"] == "disabled"


def quoted(text: Any) -> str:
    return "".join(f"%{byte:02X}" for byte in str(text).encode("utf-8", "replace"))


def test_the_description_has_every_request_and_no_get_changes_anything() -> None:
    assert {path for path, _ in REQUESTS} == {
        "/api/schema", "/api/state", "/api/programs", "/api/programs/{name}", "/api/stop",
        "/api/runs", "/api/runs/{run}/trace", "/api/runs/{run}/recording.{ending}",
        "/api/runs/{run}/report.pdf",
        "/api/drawing/shapes", "/api/drawing/dxf", "/api/drawing/text",
        "/api/guide", "/api/guide.pdf", "/api/programs/{name}/preview", "/api/wound",
    }  # fmt: skip
    assert {path for path, method in REQUESTS if method != "get"} == {
        "/api/programs/{name}", "/api/stop",
        "/api/drawing/shapes", "/api/drawing/dxf", "/api/drawing/text",  # these two keep nothing
    }  # fmt: skip
