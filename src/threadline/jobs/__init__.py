"""Jobs, and the readers of job files, one for each file format."""

from typing import TYPE_CHECKING

from threadline.base.importing import later

if TYPE_CHECKING:
    from threadline.jobs.gcode import read_part_program
    from threadline.jobs.operations import (
        Dwell,
        Feed,
        FeedMode,
        Home,
        Job,
        Move,
        Operation,
        SetOutput,
        Source,
        Stop,
        ToolEvent,
        WaitInput,
    )
    from threadline.jobs.reading import FORMATS, Format, own_product, read_job

__all__ = [
    "FORMATS", "Dwell", "Feed", "FeedMode", "Format", "Home", "Job", "Move", "Operation",
    "SetOutput", "Source", "Stop", "ToolEvent", "WaitInput", "own_product", "read_job",
    "read_part_program",
]  # fmt: skip

__getattr__ = later(
    __name__,
    {
        "gcode": "read_part_program",
        "operations": "Dwell Feed FeedMode Home Job Move Operation SetOutput Source Stop ToolEvent "
        "WaitInput",
        "reading": "FORMATS Format own_product read_job",
    },
)
