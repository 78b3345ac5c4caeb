"""Clocks, commands and recordings: what passes between planner, machine and judge."""

from threadline.signals.clock import Clock, common_period_s
from threadline.signals.commands import (
    Commands,
    SwitchSchedule,
    TickBlock,
    TickTable,
    played,
    switch_schedule,
    tick_table,
)
from threadline.signals.event import Event, EventKind
from threadline.signals.outcome import Ended, Outcome
from threadline.signals.recording import Channel, ChannelKind, Recording, RecordingBlock
from threadline.signals.step_play import StepPlay, StepTable, StitchBlock
from threadline.signals.stream import KeptStream, Stream

__all__ = [
    "Channel",
    "ChannelKind",
    "Clock",
    "Commands",
    "Ended",
    "Event",
    "EventKind",
    "KeptStream",
    "Outcome",
    "Recording",
    "RecordingBlock",
    "StepPlay",
    "StepTable",
    "StitchBlock",
    "Stream",
    "SwitchSchedule",
    "TickBlock",
    "TickTable",
    "common_period_s",
    "played",
    "switch_schedule",
    "tick_table",
]
