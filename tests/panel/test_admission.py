"""Admission of clients, and the limits of a request: host, origin, token, uploads, bad messages."""

from __future__ import annotations

import json
import shutil
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import uvicorn
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from starlette.testclient import TestClient
from starlette.websockets import WebSocketDisconnect
from tools.panel_schema import types_of

from tests.panel.bench import LOCAL, PROGRAM, Operator, operator, served
from threadline.errors import InputError, JobError, OptionError
from threadline.machine import load_machine
from threadline.machine.tool import Tool
from threadline.panel import admission, server
from threadline.panel.admission import Admission, PromptHttp, PromptWebsocket
from threadline.panel.programs import planned, program_names, program_path, take_program
from threadline.panel.protocol import MOST_TEXT, Calculate

TOKEN = "correct-horse-battery"
ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestClient]:
    with served(tmp_path_factory.mktemp("project")) as found:
        yield found


@pytest.mark.parametrize(
    "headers",
    [
        {"origin": "http://evil.example"},
        {"origin": "null"},
        {"origin": "http://127.0.0.1:9999"},
        {"host": "evil.example", "origin": "http://evil.example"},  # a name redirected to 127.0.0.1
        {"host": "127.0.0.1.evil.example"},
    ],
)
def test_other_sites_are_refused(client: TestClient, headers: dict[str, str]) -> None:
    assert client.post("/api/stop", headers=headers).status_code == 403
    assert client.get("/api/state", headers=headers).status_code == 403
    with (
        pytest.raises(WebSocketDisconnect) as refused,
        client.websocket_connect("ws://127.0.0.1/api/live", headers=headers),
    ):
        pass
    assert refused.value.code == 4403


def test_a_form_of_another_site_without_origin_is_refused(client: TestClient) -> None:
    del_origin = {"origin": "", "sec-fetch-site": "cross-site"}
    assert client.post("/api/stop", headers=del_origin).status_code == 403


def test_no_get_changes_anything(client: TestClient) -> None:
    """Each path is requested by GET and HEAD; only the read-only ones answer."""
    for path in ("/api/stop", "/api/programs/a.prg", "/api/enable", "/api/live"):
        assert client.get(path).status_code in {404, 405, 426}, path
        assert client.head(path).status_code in {404, 405, 426}, path
    while client.get("/api/state").json()["state"] == "connecting":
        time.sleep(0.05)  # the owner starts the machine by itself
    for path in ("/api/state", "/api/programs", "/api/runs", "/api/schema"):
        before = client.get("/api/state").json()["state"]
        assert client.get(path).status_code == 200
        assert client.get("/api/state").json()["state"] == before
    assert client.get("/api/state").headers["x-frame-options"] == "DENY"


def test_without_the_token_nobody_is_let_in(tmp_path: Path) -> None:
    with served(tmp_path, token=TOKEN) as client:
        assert client.get("/api/state").status_code == 401
        assert client.post("/api/stop").status_code == 401
        good = {**LOCAL, "authorization": f"Bearer {TOKEN}"}
        assert client.get("/api/state", headers=good).status_code == 200
        for token in ("", "wrong", TOKEN + "x"):
            with client.websocket_connect("ws://127.0.0.1/api/live") as socket:
                hello = {"type": "hello", "protocol": 1, "name": "Eve", "token": token}
                socket.send_text(json.dumps(hello))
                with pytest.raises(WebSocketDisconnect) as refused:
                    socket.receive_text()
                assert refused.value.code == 4401
        with operator(client, token=TOKEN) as anna:
            assert anna.number == 1


def test_other_addresses_need_a_token() -> None:
    Admission("127.0.0.1", "")
    Admission("0.0.0.0", TOKEN)
    with pytest.raises(OptionError, match="could move the machine"):
        Admission("0.0.0.0", "")
    with pytest.raises(OptionError, match="has 5 characters, the least is 16"):
        Admission("127.0.0.1", "short")


@pytest.mark.parametrize(
    "text",
    [
        "", "[]", "{}", '{"type":"hello"}', '{"type":"act"}', "\x00", '{"type":"stop","more":1}',
        '{"type":"hello","protocol":1,"name":"again"}',
        '{"type":"act","lease":"","seen":1,"number":1,"command":{"what":"jog","axis":"X","share":2}}',
        '{"type":"act","lease":"","seen":1,"number":1,"command":{"what":"jog","axis":"X","share":NaN}}',
    ],
)  # fmt: skip
def test_malformed_message_ends_the_connection(client: TestClient, text: str) -> None:
    with operator(client) as eve:
        eve.socket.send_text(text)
        with pytest.raises(WebSocketDisconnect) as refused:
            eve.until("never")
        assert refused.value.code == 4400


def test_bytes_are_no_message(client: TestClient) -> None:
    with operator(client) as eve:
        eve.socket.send_bytes(b"\x18!")
        with pytest.raises(WebSocketDisconnect):
            eve.until("never")


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(max_size=8),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(
            st.sampled_from(["type", "lease", "seen", "number", "command", "what", "axis", "word"]),
            inner
            | st.sampled_from(["act", "stop", "control", "alive", "take", "jog", "enable", "X"]),
            max_size=6,
        )
    ),
    max_leaves=12,
)


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(JSON)
def test_no_message_enables_a_machine_without_control(client: TestClient, content: Any) -> None:
    with operator(client) as eve:
        eve.socket.send_text(json.dumps(content))
        try:
            eve.until("state")
            eve.until("state")
        except WebSocketDisconnect as ended:
            assert ended.code == 4400
    assert client.get("/api/state").json()["state"] == "disabled"


@pytest.mark.parametrize("files", [(), ("index.html",)])
def test_the_published_schema_is_that_of_the_program(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, files: tuple[str, ...]
) -> None:
    """With or without a built page."""
    (page := tmp_path / "page").mkdir()
    for name in files:
        (page / name).write_text("the page", "utf-8")
    monkeypatch.setattr(server, "PAGE", page)
    published = json.loads((ROOT / "docs" / "panel-protocol.json").read_text("utf-8"))
    with served(tmp_path) as client:
        assert client.get("/").status_code == (200 if files else 404)
        schema = client.get("/api/schema").json()
    assert schema == published, "python -m tools.panel_schema writes it"
    types = (ROOT / "web" / "src" / "messages.ts").read_text("utf-8")
    assert types_of(schema) == types, "python -m tools.panel_schema writes it"
    assert MOST_TEXT == 1 << 16


def upload(client: TestClient, anna: Operator, name: str, content: bytes) -> int:
    headers = {**LOCAL, "x-lease": anna.lease}
    return client.put(f"/api/programs/{name}", content=content, headers=headers).status_code


def test_uploads_need_control_and_stay_in_the_folder(tmp_path: Path) -> None:
    project = tmp_path / "project"
    project.mkdir()
    with served(project) as client, operator(client) as anna:
        assert upload(client, anna, "a.prg", b"G1 X1;\n") == 409
        anna.take()
        assert upload(client, anna, "a.prg", b"G1 X1;\n") == 204
        assert client.get("/api/programs").json() == ["a.prg"]
        assert upload(client, anna, "b.prg", b"x" * (8 << 20) + b"x") == 413
        for name in ("..%2Fb.prg", "%2Fetc%2Fb.prg", ".b.prg", "b.exe", "b.toml.exe", "b%00.prg"):
            assert upload(client, anna, name, b"G1 X1;\n") in {404, 405, 422}, name
        assert upload(client, anna, "c.prg", b"G1 X1;\n(! at once)\n") == 422
    assert sorted(file.name for file in tmp_path.rglob("*") if file.is_file()) == ["a.prg"]


@pytest.mark.parametrize("path", ["/api/programs/a.prg", "/api/drawing/shapes"])
def test_interrupted_upload_is_no_error_of_the_panel(tmp_path: Path, path: str) -> None:
    with served(tmp_path) as client, operator(client) as anna:
        anna.take()
        came = iter([{"type": "http.request", "body": b"G1", "more_body": True}])
        answers: list[Any] = []

        async def receive() -> dict[str, Any]:
            return next(came, {"type": "http.disconnect"})

        async def send(message: Any) -> None:
            answers.append(message)

        headers = [(b"host", b"127.0.0.1"), (b"x-lease", anna.lease.encode())]
        scope = {
            "type": "http", "http_version": "1.1", "path": path, "query_string": b"name=a.dxf",
            "method": "PUT" if path.endswith(".prg") else "POST", "headers": headers,
        }  # fmt: skip
        assert client.portal is not None
        client.portal.call(client.app, scope, receive, send)
        assert not [*tmp_path.iterdir()]
    assert [one["status"] for one in answers if "status" in one] in ([], [400])


@pytest.mark.parametrize("byte", [*b"?!~\x18\x00\x7f\x80\x84\x90\xa0\xff"])
def test_bytes_that_act_at_once_are_refused_with_their_line(tmp_path: Path, byte: int) -> None:
    content = b"G1 X1\nG1 X2 (" + bytes([byte]) + b")\n"
    with pytest.raises(
        JobError, match=rf"a\.gcode:2: controllers execute the byte {byte:#04x} at once"
    ):
        take_program(tmp_path, "a.gcode", content, overwrite=False)
    frame = load_machine("schiffli-frame")
    assert program_names(tmp_path, frame) == []
    take_program(tmp_path, "a.dst", content, overwrite=False)  # an embroidery design is not text
    assert program_names(tmp_path, frame) == ["a.dst"]


def test_jobs_of_the_machine_are_offered_and_no_other_files(tmp_path: Path) -> None:
    """Machines and specifications are TOML, too; a drawing is sewn through a seam file.

    A product without layers is no job: nothing is wound on it.
    """
    for name in (
        "a.seam.toml", "a.svg", "a.dxf", "a.csv", "a.prg", "a.dst", "a.json", ".a.prg",
    ):  # fmt: skip
        (tmp_path / name).write_text("")
    (tmp_path / "cycle.toml").write_text('name = "cycle"\n[[operation]]\ndwell = "1 s"\n')
    (tmp_path / "damaged.toml").write_text("name = \n[[ operation ]]\n")  # refused, and why
    (tmp_path / "inline.toml").write_text('operation = [{dwell = "1 s"}]\n')
    (tmp_path / "machine.toml").write_text('base = "letter-placer"\n# [[operation]]\n')
    (tmp_path / "mine.spec.toml").write_text('[[criteria]]\nname = "travel"\n')
    (tmp_path / "job.txt").write_text("; notes first\nG1 X5 F100\n")
    (tmp_path / "vessel.wind.toml").write_text('name = "vessel"\n[[layer]]\nkind = "hoop"\n')
    (tmp_path / "mandrel.wind.toml").write_text('name = "mandrel"\n# [[layer]]\n[band]\n')
    (tmp_path / "notes.txt").write_text("$0=10\ngrease the axes G and X\n")
    (tmp_path / "folder.prg").mkdir()
    programs = ["a.prg", "a.seam.toml", "job.txt"]
    for machine, offered in (
        ("lathe-winder", [*programs, "vessel.wind.toml"]),
        ("stepper-winder", ["a.prg", "job.txt", "vessel.wind.toml"]),
        ("stitcher", programs),  # it has no eye
        ("letter-placer", ["cycle.toml", "damaged.toml", "inline.toml"]),
        ("schiffli-frame", ["a.dst"]),
    ):
        assert program_names(tmp_path, load_machine(machine)) == offered
    upright = load_machine("lathe-winder")
    assert upright.tool is not None
    bare = Tool(radius=upright.tool.radius)
    upright = replace(upright, axes={**upright.axes, "Y": upright.axes["A"]}, tool=bare)
    assert program_names(tmp_path, upright) == [
        "a.prg",
        "job.txt",
    ]  # without a seam file


@pytest.mark.parametrize("to", ["../secret.prg", "a.prg", "b.prg", "nowhere.prg"])
def test_links_are_not_followed(tmp_path: Path, to: str) -> None:
    """A link is not followed out of the folder, within it, or to itself."""
    project = tmp_path / "project"
    project.mkdir()
    for file in (tmp_path / "secret.prg", project / "b.prg"):
        file.write_text("secret", "utf-8")
    (project / "a.prg").symlink_to(to)
    with pytest.raises(JobError, match=r"'a\.prg' is a link, and the panel follows none"):
        program_path(project, "a.prg")
    with pytest.raises(JobError, match="is a link"):
        take_program(project, "a.prg", b"new", overwrite=True)
    assert program_names(project, load_machine("lathe-winder")) == ["b.prg"]
    assert {(tmp_path / "secret.prg").read_text(), (project / "b.prg").read_text()} == {"secret"}


def test_an_upload_over_a_link_to_itself_is_refused_in_a_line(tmp_path: Path) -> None:
    (tmp_path / "a.prg").symlink_to("a.prg")
    with served(tmp_path) as client, operator(client) as anna:
        headers = {**LOCAL, "x-lease": anna.take().lease}
        answer = client.put("/api/programs/a.prg", content=b"%", headers=headers)
        assert (answer.status_code, answer.text.count("\n")) == (422, 1)
        assert client.get("/api/programs").json() == []


def test_an_upload_asks_before_it_overwrites(tmp_path: Path) -> None:
    (tmp_path / "a.prg").write_text("old", "utf-8")
    with served(tmp_path) as client, operator(client) as anna:
        headers = {**LOCAL, "x-lease": anna.take().lease}
        answer = client.put("/api/programs/a.prg", content=b"new", headers=headers)
        assert answer.status_code == 412
        assert answer.text == "a.prg is in the project folder already\n"
        assert (tmp_path / "a.prg").read_text("utf-8") == "old"
        headers["x-overwrite"] = "yes"
        answer = client.put("/api/programs/a.prg", content=b"new", headers=headers)
        assert answer.status_code == 204
        assert (tmp_path / "a.prg").read_text("utf-8") == "new"


@pytest.mark.parametrize(
    ("program", "words"),
    [
        ("out.seam.toml", {}),
        ("link.seam.toml", {}),
        ("there.prg", {"law": "../secret.csv"}),
        ("there.prg", {"radius": "A=../secret.csv"}),
        ("there.prg", {"radius": "A=/etc/secret.csv"}),
    ],
)
def test_no_file_outside_of_the_project_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, program: str, words: dict[str, str]
) -> None:
    """Neither a program nor an option can name such a file, and no message shows its content."""
    project = tmp_path / "project"
    project.mkdir()
    secret = tmp_path / "secret.csv"
    secret.write_text("x_mm,y_mm\n0,0\n10,4711\n", "utf-8")
    (project / "link.csv").symlink_to(secret)
    (project / "there.prg").write_text(PROGRAM, "utf-8")
    for name, file in (("out", "../secret.csv"), ("link", "link.csv")):
        text = (ROOT / "examples" / "strap.seam.toml").read_text("utf-8")
        assert "strap.csv" in text
        (project / f"{name}.seam.toml").write_text(text.replace("strap.csv", file), "utf-8")
    monkeypatch.chdir(project)
    opened = []
    real = Path.open

    def noted(file: Path, *given: Any, **named: Any) -> Any:
        opened.append(file.resolve())
        return real(file, *given, **named)

    monkeypatch.setattr(Path, "open", noted)
    asked = Calculate(what="calculate", program=program, **words)  # type: ignore[arg-type]
    machine = load_machine("stitcher" if program.endswith(".toml") else "lathe-winder")
    with pytest.raises(InputError, match=r"not in the project folder|links are not followed") as no:
        planned(project, asked.model_dump(exclude={"what"}), machine)
    assert "4711" not in str(no.value)
    assert secret not in opened


def test_files_of_the_project_folder_are_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The guard allows every file in the folder, however the folder is named."""
    project = tmp_path / "project"
    project.mkdir()
    (tmp_path / "other-name").symlink_to(project)
    for name in ("strap.seam.toml", "strap.csv"):
        shutil.copy(ROOT / "examples" / name, project)
    asked = Calculate(what="calculate", program="strap.seam.toml").model_dump(exclude={"what"})
    monkeypatch.chdir(tmp_path)
    for folder in (
        project,
        tmp_path / "other-name",
        Path("project"),
        Path("other-name/../project"),
    ):
        plan, _ = planned(folder, asked, load_machine("stitcher"))
        assert plan.duration_s > 1.0


# --- clients that connect and do not finish a request -------------------------------------


async def answering(_: Any, receive: Any, send: Any) -> None:
    """Answer whole requests with 204."""
    while (await receive()).get("more_body"):
        pass
    await send({"type": "http.response.start", "status": 204, "headers": []})
    await send({"type": "http.response.body", "body": b""})


@contextmanager
def listening(app: Any = answering) -> Iterator[tuple[str, int]]:
    """Serve an application through connections that are dropped in time."""
    own = socket.create_server(("127.0.0.1", 0))
    config = uvicorn.Config(
        app, http=PromptHttp, ws=PromptWebsocket, lifespan="off", log_level="critical"
    )
    server = uvicorn.Server(config)
    thread = threading.Thread(target=server.run, args=([own],), daemon=True)
    thread.start()
    try:
        yield own.getsockname()
    finally:
        server.should_exit = True
        thread.join(60.0)
        own.close()


HEAD = b"PUT /api/programs/x.prg HTTP/1.1\r\nHost: 127.0.0.1\r\n"


def sent(address: tuple[str, int], content: bytes) -> socket.socket:
    found = socket.create_connection(address, 60.0)
    found.sendall(content)
    return found


def dropped(one: socket.socket) -> bytes:
    """Return the data until the other side closes a connection, and close it."""
    came = b""
    with one, suppress(ConnectionResetError):  # the other side closed it with unread data
        while more := one.recv(4096):
            came += more
    return came


@pytest.mark.parametrize(
    "half",
    [
        b"",
        HEAD,
        HEAD + b"Content-Length: 10\r\n\r\n",
        HEAD + b"Content-Length: 10\r\n\r\n12345",
        HEAD + b"Transfer-Encoding: chunked\r\n\r\n5\r\n12",
        HEAD + b"Content-Length: 2\r\n\r\n12" + HEAD,
    ],
)
def test_half_a_request_is_dropped_in_time(half: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(admission, "HALF_OPEN_S", 0.3)
    with listening() as address:
        came = dropped(sent(address, half))
        assert came.count(b"204 No Content") == half.count(b"Content-Length: 2\r")
        assert not PromptHttp.half_open


def test_a_slow_body_is_taken_and_one_without_end_is_not(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(admission, "HALF_OPEN_S", 4.0)
    with listening() as address:
        slow = sent(address, HEAD + b"Content-Length: 4\r\nConnection: close\r\n\r\n")
        for _ in range(4):
            time.sleep(0.7)
            slow.sendall(b"1")
        assert b"204 No Content" in dropped(slow)
        monkeypatch.setattr(admission, "MOST_BODY_S", 0.3)
        endless = sent(address, HEAD + b"Content-Length: 40\r\n\r\n")
        time.sleep(0.2)
        endless.sendall(b"1")
        assert dropped(endless) == b""


def test_a_stop_gets_through_past_many_half_requests(monkeypatch: pytest.MonkeyPatch) -> None:
    """Beyond the most connections the oldest is dropped; the time limit drops none here."""
    monkeypatch.setattr(admission, "HALF_OPEN_S", 600.0)
    monkeypatch.setattr(admission, "MOST_HALF_OPEN", 20)
    with listening() as address:
        many = [sent(address, HEAD) for _ in range(60)]
        stop = sent(address, HEAD + b"Content-Length: 0\r\nConnection: close\r\n\r\n")
        assert b"204 No Content" in dropped(stop)
        assert [dropped(one) for one in many[:40]] == [b""] * 40
        for one in many[40:]:
            one.close()


SOCKET = (
    b"GET /api/live HTTP/1.1\r\nHost: 127.0.0.1\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    b"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n"
)


def test_a_websocket_without_a_hello_is_dropped_in_time(
    client: TestClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It does not answer the close, either."""
    monkeypatch.setattr(admission, "HELLO_S", 0.3)
    with listening(client.app) as address:
        began_s = time.monotonic()
        assert b"no hello came" in dropped(sent(address, SOCKET))
        assert time.monotonic() - began_s < 8.0  # the library alone waits 10 s for the answer


def test_only_so_many_websockets_may_be_without_a_hello(
    client: TestClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Beyond the most websockets the oldest is closed; the time limit closes none here."""
    monkeypatch.setattr(admission, "HELLO_S", 600.0)
    monkeypatch.setattr(admission, "MOST_WITHOUT_HELLO", 5)
    with listening(client.app) as address:
        many = [sent(address, SOCKET) for _ in range(12)]
        assert [b"no hello came" in dropped(one) for one in many[:7]] == [True] * 7
        for one in many[7:]:
            one.settimeout(0.2)
            with suppress(TimeoutError):
                while one.recv(4096):
                    pass
                pytest.fail("a websocket that had a place was closed")
            one.close()
