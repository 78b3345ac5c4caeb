"""One table has every transition; the document prints it, and the executor keeps to it."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from tests.live.bench import Bench, table_of_counts, there_and_back
from threadline.errors import CommandError
from threadline.live.states import COMMANDS, MOVING, TRANSITIONS, Cause, State, next_state

ROOT = Path(__file__).parents[2]
TABLE = table_of_counts(there_and_back(cruise=40))


@pytest.mark.parametrize("state", State)
@pytest.mark.parametrize("cause", Cause)
def test_command_without_a_transition_is_refused(state: State, cause: Cause) -> None:
    if (state, cause) in TRANSITIONS:
        assert next_state(state, cause) is TRANSITIONS[state, cause]
    else:
        with pytest.raises(CommandError, match=f"while the machine is {state.value}") as refused:
            next_state(state, cause)
        possible = {c.value for s, c in TRANSITIONS if s is state and c in COMMANDS}
        assert set(refused.value.remedy.removeprefix("Possible now: ")[:-1].split(", ")) == possible


def test_the_document_prints_the_table() -> None:
    page = (ROOT / "docs" / "safety.md").read_text(encoding="utf-8")
    page = page.partition("| from |")[2].partition("\n\n")[0]
    rows = re.findall(r"^\| (\w+) \| ([\w ,]+) \| (\w+) \|$", page, re.M)
    printed = {(State(f), Cause(by)): State(to) for f, by, to in rows}
    assert printed == TRANSITIONS


def test_a_hold_after_the_last_row_is_refused_and_the_run_ends() -> None:
    """The machine only settles: a hold would keep it holding a finished run for good."""
    made = Bench().ready()
    made.executor.start(TABLE)
    while made.executor.ended is None:
        made.executor.step()
    made.desk.ask(Cause.HOLD)
    made.go_on()
    assert made.executor.state is State.IDLE
    assert any("the run has come to its end" in text for *_, text in made.sink.log)


def test_safe_by_construction() -> None:
    """A stop and a fault are possible in every state; a start needs idle, idle needs homing."""
    for state in State:
        assert (state, Cause.STOP) in TRANSITIONS
        assert TRANSITIONS[state, Cause.FAULT] is State.FAULT
    assert {s for s, c in TRANSITIONS if c is Cause.START} == {State.IDLE}
    assert {s for (s, c), after in TRANSITIONS.items() if after in MOVING and s not in MOVING} == {
        State.ENABLED, State.IDLE,
    }  # fmt: skip
    assert TRANSITIONS[State.FAULT, Cause.RESET] is State.DISABLED
    # Every way from off, or from a fault, to motion passes homing.
    reached, edge = set(), {State.DISABLED, State.FAULT}
    while edge:
        reached |= edge
        edge = {
            after
            for (s, c), after in TRANSITIONS.items()
            if s in edge and c not in {Cause.HOMED, Cause.AT_REST}
        } - reached
    assert not reached & {State.RUNNING, State.JOGGING, State.HOLDING, State.IDLE}


class Walk(RuleBasedStateMachine):
    """Commands at any time: the executor has the table's state, and moves only when allowed."""

    def __init__(self) -> None:
        super().__init__()
        self.bench = Bench()
        self.executor = self.bench.executor
        self.model = State.DISABLED
        self.before = self.model
        self.stood = self.bench.wire.machine.position.copy()

    def command(self, cause: Cause, call: object = None) -> None:
        """Give a command by its method or at the desk; the model takes it, or both refuse."""
        expected = TRANSITIONS.get((self.model, cause))
        if callable(call):
            if expected is None:
                with pytest.raises(CommandError):
                    call()
                return
            call()
        else:
            self.bench.desk.ask(cause)
            self.executor.obey()
        if expected is not None:
            self.model = expected

    @rule()
    def enable(self) -> None:
        self.command(Cause.ENABLE, self.executor.enable)

    @rule()
    def disable(self) -> None:
        self.command(Cause.DISABLE, self.executor.disable)

    @rule()
    def home(self) -> None:
        if (self.model, Cause.HOME) in TRANSITIONS:
            self.executor.home()
            self.model = State.IDLE  # homing and homed
        else:
            self.command(Cause.HOME, self.executor.home)

    @rule()
    def reset(self) -> None:
        self.command(Cause.RESET, self.executor.reset)

    @rule()
    def start(self) -> None:
        if self.model is State.IDLE and self.executor._stands.any():
            with pytest.raises(CommandError, match="stands at"):
                self.executor.start(TABLE)
            return
        self.command(Cause.START, lambda: self.executor.start(TABLE))

    @rule(velocity=st.sampled_from([-0.05, 0.02, 0.07]))
    def jog(self, velocity: float) -> None:
        self.command(Cause.JOG, lambda: self.executor.jog("X", velocity))

    @precondition(lambda self: self.model is State.JOGGING)
    @rule()
    def renew_or_let_go(self) -> None:
        self.executor.renew()
        self.executor.let_go()

    @rule(cause=st.sampled_from([Cause.HOLD, Cause.RESUME, Cause.STOP]))
    def at_the_desk(self, cause: Cause) -> None:
        self.command(cause)

    @precondition(lambda self: self.model in MOVING)
    @rule(groups=st.integers(1, 30))
    def time(self, groups: int) -> None:
        for _ in range(groups):
            if self.executor.over:
                break
            self.executor.step()
        if self.executor.over and self.model in {State.RUNNING, State.STOPPING, State.JOGGING}:
            self.model = State.IDLE

    @precondition(lambda self: self.model is State.RUNNING)
    @rule()
    def refills_are_lost(self) -> None:
        self.bench.wire.machine.starved = True
        self.time(1)
        self.model = State.FAULT
        while not self.executor.over:
            self.executor.step()

    @invariant()
    def it_is_where_the_table_says(self) -> None:
        assert self.executor.state is self.model

    @invariant()
    def it_moves_only_where_it_may(self) -> None:
        machine = self.bench.wire.machine
        stands = machine.position.copy()
        if self.before not in MOVING and self.model not in MOVING:
            assert (stands == self.stood).all()
        if self.model not in MOVING:
            assert machine.standing
        self.stood, self.before = stands, self.model


TestWalk = Walk.TestCase
TestWalk.settings = settings(max_examples=25, stateful_step_count=25, deadline=None)
