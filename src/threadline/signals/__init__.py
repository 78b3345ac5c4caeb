"""Clocks, commands and recordings: what passes between planner, machine and judge."""

from threadline.signals.clock import Clock, common_period_s
from threadline.signals.commands import Commands, Event, SwitchSchedule, TickBlock, TickTable
from threadline.signals.recording import Channel, ChannelKind, Recording, RecordingBlock
from threadline.signals.stream import Stream

__all__ = [
    "Channel",
    "ChannelKind",
    "Clock",
    "Commands",
    "Event",
    "Recording",
    "RecordingBlock",
    "Stream",
    "SwitchSchedule",
    "TickBlock",
    "TickTable",
    "common_period_s",
]
