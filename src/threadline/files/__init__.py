"""Clocks, commands and recordings as types, and the files that hold them."""

from typing import TYPE_CHECKING

from threadline.base.importing import later

if TYPE_CHECKING:
    from threadline.files.clock import Clock, Event, EventKind, common_period_s
    from threadline.files.commands import (
        Commands,
        Creep,
        SwitchSchedule,
        TickBlock,
        TickTable,
        played,
        switch_schedule,
        tick_table,
    )
    from threadline.files.recording import (
        Channel,
        ChannelKind,
        Outcome,
        Recording,
        RecordingBlock,
        RunEnd,
    )
    from threadline.files.step_play import StepPlay, StepTable, StitchBlock
    from threadline.files.stream import CachedStream, Stream

__all__ = [
    "CachedStream",
    "Channel",
    "ChannelKind",
    "Clock",
    "Commands",
    "Creep",
    "Event",
    "EventKind",
    "Outcome",
    "Recording",
    "RecordingBlock",
    "RunEnd",
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
]  # fmt: skip

__getattr__ = later(
    __name__,
    {
        "clock": "Clock Event EventKind common_period_s",
        "commands": "Commands Creep SwitchSchedule TickBlock TickTable played switch_schedule "
        "tick_table",
        "recording": "Channel ChannelKind Outcome Recording RecordingBlock RunEnd",
        "step_play": "StepPlay StepTable StitchBlock",
        "stream": "CachedStream Stream",
    },
)
