"""Remove a guard of the panel: the test that the table of hazards names for it fails.

Nobody may leave out a guard, so none has a setting: it is removed where it is, though private.
"""

from __future__ import annotations

import gc
import warnings
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.live.test_guards_removed import Take, attribute, nothing
from tests.panel import (
    test_admission,
    test_console,
    test_control,
    test_links,
    test_operator,
)
from tests.panel.bench import PROGRAM, proven, served
from threadline.base import reading as input_files
from threadline.live import grbl_controller as grbl_by_hand
from threadline.live import grbl_operated, supervised
from threadline.live.grbl_console import ConsoleLine
from threadline.live.grbl_operated import GrblOperated
from threadline.live.states import Cause
from threadline.panel import owner
from threadline.panel import programs as project_programs
from threadline.panel.admission import Admission
from threadline.panel.control import Client, ControlLease
from threadline.panel.owner import Owner
from threadline.panel.panel import Panel


def leaves_it_moving(panel: Panel, client: Client) -> None:
    """Forget a client that is gone, and let its jog go on."""
    panel._clients.pop(client.number, None)


def stops_and_forgets(one: Owner) -> None:
    """Stop the motion, but no waiting request."""
    one._desk.ask(Cause.STOP)


def alarm_is_well(monkeypatch: pytest.MonkeyPatch) -> None:
    """Note the position of a controller at rest, whatever else it reports; a test waits less."""
    monkeypatch.setattr(GrblOperated, "_report_at_rest", GrblOperated._note)
    monkeypatch.setattr(test_links, "PATIENCE_S", 2.0)


def reads_outside(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    options = {"radius": "A=../secret.csv"}
    test_admission.test_no_file_outside_of_the_project_is_read(
        folder, monkeypatch, "there.prg", options
    )


def of_another_site(folder: Path) -> None:
    with served(folder) as client:
        test_admission.test_other_sites_are_refused(client, {"origin": "http://evil.example"})


_OWN = frozenset({"the origin", "names in the folder alone", "files of the project alone"})
"""Guards whose tests have a folder of their own."""
Test = Callable[[Path], None]
GUARDS: dict[str, tuple[Take, Test]] = {
    "the origin": (attribute(Admission, "refusal", nothing), of_another_site),
    "the token": (
        attribute(Admission, "knows", lambda *_: True),
        test_admission.test_without_the_token_nobody_is_let_in,
    ),
    "names in the folder alone": (
        attribute(project_programs, "program_path", lambda folder, name: folder / name),
        lambda folder: test_admission.test_links_are_not_followed(folder, "../secret.prg"),
    ),
    "files of the project alone": (
        attribute(input_files, "_refuse_outside", nothing),
        lambda folder: with_patch(reads_outside, folder),
    ),
    "bytes that act at once": (
        attribute(project_programs, "_refuse_realtime", nothing),
        lambda folder: test_admission.test_bytes_that_act_at_once_are_refused_with_their_line(
            folder, 0x18
        ),
    ),
    "one lease": (
        attribute(ControlLease, "renew", lambda *_: True),
        lambda _: test_control.test_lease_of_control_agrees_with_a_simple_model(),
    ),
    "a lease that expires": (
        attribute(ControlLease, "pass_if_due", lambda *_: None),
        lambda _: test_control.test_control_is_free_five_seconds_after_its_holder_is_gone(),
    ),
    "a state that was seen": (
        attribute(Client, "saw", lambda *_: True),
        lambda _: test_control.test_a_state_may_be_acted_on_for_half_a_second(),
    ),
    "a command once": (
        attribute(Client, "is_next", lambda *_: True),
        lambda _: test_control.test_a_state_may_be_acted_on_for_half_a_second(),
    ),
    "a connection that ends": (
        attribute(Panel, "leave", leaves_it_moving),
        test_operator.test_a_connection_that_ends_lets_go,
    ),
    "what was asked for before a stop": (
        attribute(Owner, "_stop", stops_and_forgets),
        lambda folder: with_patch(test_operator.test_a_stop_before_it_begins_ends_a_start, folder),
    ),
    "the hashes of what is started": (
        attribute(supervised, "check_proof", lambda *_: ()),
        test_operator.test_a_program_that_was_changed_since_is_not_run,
    ),
    "the little that grbl is sent ahead": (
        attribute(grbl_by_hand, "AHEAD_S", 2.0),
        test_links.test_a_jog_on_grbl_ends_where_nobody_renews_it,
    ),
    "a server that is silent": (
        attribute(owner, "SILENT_S", 1e9),
        test_operator.test_a_silent_server_is_one_that_could_not_stop_it,
    ),
    "a console that moves nothing": (
        attribute(grbl_operated, "console_line", ConsoleLine),
        test_console.test_typed_lines_are_answered_and_a_written_setting_has_to_be_compared,
    ),
    "no typed line in a run": (
        attribute(GrblOperated, "_refuse_moving", nothing),
        lambda _: test_console.test_a_line_is_not_sent_in_a_run_nor_in_its_hold(),
    ),
    "settings that are compared after they were written": (
        attribute(grbl_by_hand.Controller, "compare", nothing),
        test_console.test_typed_lines_are_answered_and_a_written_setting_has_to_be_compared,
    ),
    "a controller in alarm at rest": (
        alarm_is_well,
        test_links.test_an_alarm_at_rest_is_a_fault_and_a_reset_leaves_it,
    ),
}


def with_patch(test: Callable[[Path, pytest.MonkeyPatch], None], folder: Path) -> None:
    with pytest.MonkeyPatch.context() as monkeypatch:
        test(folder, monkeypatch)


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of ``test_operator``, whose program is proven once for both files."""
    folder = tmp_path_factory.getbasetemp() / "proven-project"
    folder.mkdir(exist_ok=True)
    proven(folder)
    return folder


@pytest.mark.parametrize("guard", GUARDS)
def test_without_the_guard_its_test_fails(
    guard: str, project: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    take_away, test = GUARDS[guard]
    take_away(monkeypatch)
    own = getattr(test, "__module__", "") == test_admission.__name__ or guard in _OWN
    (project / "there.prg").write_text(PROGRAM, "utf-8")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)  # a failing test closes nothing
        with pytest.raises((AssertionError, pytest.fail.Exception)):
            test(tmp_path if own else project)
        gc.collect()
