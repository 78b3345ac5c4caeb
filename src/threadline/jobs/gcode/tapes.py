"""The lines with % that open and close a file, both or neither."""

from __future__ import annotations

from threadline.errors import JobError
from threadline.jobs.gcode.textfile import SourceFile

TAPE = "%"


class Tapes:
    """The % of a file, in their order.

    Parameters
    ----------
    file
        The file, for errors.
    """

    def __init__(self, file: SourceFile) -> None:
        self._file = file
        self._lines: list[int] = []

    def take(self, line: int, begun: bool) -> None:
        """Take a %; ``begun`` says whether blocks stand before it.

        Raises
        ------
        JobError
            If it closes a program that none has opened.
        """
        self._lines.append(line)
        if len(self._lines) > 2 or (len(self._lines) == 1 and begun):
            raise JobError(
                "this % closes a program that none has opened",
                place=self._file.place(line),
                remedy="Write % on the first line and on the last, or on none.",
            )

    def check(self, line: int) -> None:
        """Refuse a block behind the last %.

        Raises
        ------
        JobError
            If there is one.
        """
        if len(self._lines) > 1:
            raise JobError(
                "a block after the % that ends the file is never run",
                place=self._file.place(line),
                remedy="Take it out.",
            )

    def finish(self, line: int) -> None:
        """End the file behind ``line``.

        Raises
        ------
        JobError
            If a % is open.
        """
        if len(self._lines) == 1:
            raise JobError(
                f"the % on line {self._lines[0]} opens the program and none closes it: the file "
                "may be truncated",
                place=self._file.place(line),
                remedy="Add a line with % at the end.",
            )
