"""Clocks, commands and recordings: what passes between planner, machine and judge."""

from threadline.signals.clock import Clock, common_period_s
from threadline.signals.commands import (
    Commands,
    Event,
    EventKind,
    SwitchSchedule,
    TickBlock,
    TickTable,
    switch_schedule,
    tick_table,
)
from threadline.signals.outcome import Ended, Outcome
from threadline.signals.recording import Channel, ChannelKind, Recording, RecordingBlock
from threadline.signals.shaft import ShaftClock
from threadline.signals.step_play import StepPlay, StitchBlock
from threadline.signals.stream import Stream

__all__ = [
    "Channel",
    "ChannelKind",
    "Clock",
    "Commands",
    "Ended",
    "Event",
    "EventKind",
    "Outcome",
    "Recording",
    "RecordingBlock",
    "ShaftClock",
    "StepPlay",
    "StitchBlock",
    "Stream",
    "SwitchSchedule",
    "TickBlock",
    "TickTable",
    "common_period_s",
    "switch_schedule",
    "tick_table",
]
