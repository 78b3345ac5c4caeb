"""A strict model of a controller with grbl, behind a TCP port.

Written from "Grbl v1.1 Interface" of gnea/grbl, and not from the code that is tested: a receive
buffer of 128 characters whose overflow is a failure, a planner of few blocks, an answer to each
line when it enters the planner, realtime bytes that act at once, straight moves at their feed.
Motion has no ramps, and the time is its own: a sleep for each step.
"""

from __future__ import annotations

import re
import select
import socket
import threading
import time
from collections import deque
from contextlib import suppress

import numpy as np

ROOM, BLOCKS = 128, 15
STEP_S = 0.01
WELCOME = "Grbl 1.1h ['$' for help]"


class GrblModel(threading.Thread):
    """One controller with axes X, Y, Z, A.

    Attributes
    ----------
    overflowed
        Whether more was sent than the buffer holds.
    moved_to
        Positions at every step, until now.
    moves_since_lost
        Time in s that it moved on after the link was lost.
    beside_mm
        How far beside the place where X is it is reported.
    ahead_s
        The most time in s, at the feeds, that it has held in jogs.
    overrides
        Feed, rapids and spindle in %, reported once after each change.
    """

    def __init__(
        self, settings: dict[int, float], *, faster: float = 1.0, blocks: int = BLOCKS,
        characters: int = ROOM, port: int = 0,
    ) -> None:  # fmt: skip
        super().__init__(daemon=True)
        self.homing_s, self.homed_at_s = 0.0, np.inf
        self.server = socket.create_server(("127.0.0.1", port))
        self.port = self.server.getsockname()[1]
        self.settings, self.faster, self.room = settings, faster, blocks
        self.characters = characters
        self.state, self.at = "Idle", np.zeros(4)
        self.overflowed = self.stuck = False
        self.alarm_at_s: float | None = None
        self.moves_since_lost = self.beside_mm = 0.0
        self.heard = bytearray()
        self.moved_to: list[np.ndarray] = []
        self.rx = bytearray()
        self.answers: deque[str] = deque()
        self.blocks: deque[tuple[np.ndarray, float]] = deque()
        self.target, self.feed, self.rapid = np.zeros(4), 0.0, True
        self.ahead_s = 0.0
        self.overrides = self.reported_overrides = (100, 100, 100)
        self.overridable = True
        self.at_stop = False
        self.mute = False
        self.client: socket.socket | None = None
        self.over = False

    @property
    def address(self) -> str:
        return f"127.0.0.1:{self.port}"

    def run(self) -> None:
        self.client, _ = self.server.accept()
        self.client.setblocking(False)
        self._say(WELCOME)
        began = last = time.monotonic()
        while not self.over:
            self._listen()
            if time.monotonic() >= self.homed_at_s:
                self.at, self.homed_at_s = np.zeros(4), np.inf
                self.state, self.target = "Idle", self.at.copy()
                self._say("ok")
            self._plan()
            now = time.monotonic()
            self._move(self.faster * min(now - last, 0.2))
            last = now
            if self.alarm_at_s is not None and now - began > self.alarm_at_s:
                self.state, self.alarm_at_s = "Alarm", None
                self._say("ALARM:1")
            time.sleep(STEP_S)

    def close(self) -> None:
        self.over = True
        self.join(5.0)
        for one in (self.client, self.server):
            if one is not None:
                one.close()

    def _say(self, line: str) -> None:
        if self.client is not None:
            with suppress(OSError):
                self.client.sendall(f"{line}\r\n".encode())

    def _listen(self) -> None:
        if self.client is None or not select.select([self.client], [], [], 0.0)[0]:
            return
        try:
            came = self.client.recv(4096)
        except OSError:
            came = b""
        if not came:  # the link is gone: it goes on with what it has
            self.client.close()
            self.client = None
            return
        self.heard += came
        if self.overridable:
            self._override({byte for byte in came if 0x90 <= byte <= 0x94})
        for byte in came:
            if byte in b"?!~\x18\x85":
                self._at_once(byte)
            elif 0x90 <= byte <= 0x94:
                continue
            elif byte != 13:
                self.rx.append(byte)
        self.overflowed = self.overflowed or len(self.rx) > self.characters

    def _override(self, flags: set[int]) -> None:
        """Step the override of the feed: grbl keeps one flag for each byte until it acts."""
        feed = 100 if 0x90 in flags else self.overrides[0]
        for byte, by in ((0x91, 10), (0x92, -10), (0x93, 1), (0x94, -1)):
            if byte in flags:
                feed = min(max(feed + by, 10), 200)
        self.overrides = (feed, *self.overrides[1:])

    def _at_once(self, byte: int) -> None:
        if byte == ord("?"):
            state = {"Hold": "Hold:0"}.get(self.state, self.state)
            shown = self.at + np.array([self.beside_mm, 0.0, 0.0, 0.0])
            place = ",".join(f"{value:.3f}" for value in shown)
            if not self.stuck:
                free = f"{self.room - len(self.blocks)},{self.characters}"
                overrides = ""
                if self.overrides != self.reported_overrides:
                    self.reported_overrides = self.overrides
                    overrides = f"|Ov:{','.join(map(str, self.overrides))}"
                self._say(f"<{state}|MPos:{place}|Bf:{free}|FS:0,0{overrides}>")
        elif byte in (0x85, ord("!")) and self.state == "Jog":  # lines in the buffer stay there
            self.blocks.clear()
            self.state, self.target = "Idle", self.at.copy()
        elif byte == ord("!") and self.state == "Run":
            self.state = "Hold"
        elif byte == ord("~") and self.state in {"Hold", "Door:0"}:
            self.state = "Run"
        elif byte == 0x18:
            if self.state in {"Run", "Jog"} or self.homed_at_s < np.inf:
                self._say("ALARM:3")
            self.homed_at_s = np.inf
            self.overrides = (100, 100, 100)
            self.rx.clear()
            self.blocks.clear()
            self.state, self.target, self.feed = "Idle", self.at.copy(), 0.0
            self._say(WELCOME)

    def _plan(self) -> None:
        """Take lines into the planner while it has room; a line is answered when it enters."""
        while b"\n" in self.rx and len(self.blocks) < self.room:
            line, _, rest = bytes(self.rx).partition(b"\n")
            if line == b"M0" and not self._passed_stop():
                return
            self.rx = bytearray(rest)
            if not self.mute:
                self._do(line.decode("ascii"))

    def _passed_stop(self) -> bool:
        """Hold at an M0 once all moves before it are done; return whether it was resumed.

        Grbl 1.1, gcode.c: ``protocol_buffer_synchronize``, then a feed hold, and the answer last.
        """
        if self.blocks or self.state == "Hold":
            return False
        self.at_stop = not self.at_stop
        if self.at_stop:
            self.state = "Hold"
        return not self.at_stop

    def _do(self, line: str) -> None:
        if line == "$I":
            self._say("[VER:1.1h.20190825:]")
            self._say(f"[OPT:V,{self.room},{self.characters}]")
            self._say("[AXS:4:XYZA]")
        elif line == "$$":
            for number, value in self.settings.items():
                self._say(f"${number}={value:.5f}")
        elif (written := re.fullmatch(r"\$(\d+)=([\d.]+)", line)) is not None:
            self.settings[int(written[1])] = float(written[2])
        elif line == "$#":
            self._say("[G54:0.000,0.000,0.000,0.000]")
            self._say("[G92:0.000,0.000,0.000,0.000]")
        elif line == "$X":
            self.state = "Idle"
            self._say("[MSG:Caution: Unlocked]")
        elif line.startswith("$J="):
            if why := self._jog(line[3:]):
                self._say(why)
                return
        elif line == "$H":  # answered when it is done
            self.state, self.homed_at_s = "Home", time.monotonic() + self.homing_s
            return
        elif self.state == "Alarm":
            self._say("error:9")
            return
        elif line.startswith("T"):
            self._say("error:20")
            return
        elif line == "M0":
            pass
        elif why := self._take_move(line):
            self._say(why)
            return
        self._say("ok")

    def _jog(self, words: str) -> str:
        """Plan a jog, which leaves feed and modes unchanged; return an error, or nothing."""
        if self.state not in {"Idle", "Jog"}:
            return "error:8"
        found = re.fullmatch(r"G21G90G53([XYZA])(-?[\d.]+)F([\d.]+)", words)
        if found is None:
            return "error:16"
        target = self.target.copy()
        target["XYZA".index(found[1])] = float(found[2])
        if not np.array_equal(target, self.target):
            self.blocks.append((target, float(found[3]) / 60.0))
            self.target, self.state = target, "Jog"
            ends = [self.at, *(end for end, _ in self.blocks)]
            moves = np.linalg.norm(np.diff(ends, axis=0), axis=1)
            left = sum(way / speed for way, (_, speed) in zip(moves, self.blocks, strict=True))
            self.ahead_s = max(self.ahead_s, float(left))
        return ""

    def _take_move(self, line: str) -> str:
        """Plan a move, a rapid at the slowest of its axes' rates; return an error, or nothing."""
        if (motion := re.search(r"G0*([01])(?!\d)", line)) is not None:
            self.rapid = motion[1] == "0"
        target = self.target.copy()
        for letter, value in re.findall(r"([XYZAF])(-?[\d.]+)", line):
            if letter == "F":
                self.feed = float(value)
            else:
                target["XYZA".index(letter)] = float(value)
        if np.array_equal(target, self.target):
            return ""
        rates = [self.settings[110 + axis] for axis in np.flatnonzero(target != self.target)]
        feed = min(rates) if self.rapid else self.feed
        if not feed > 0.0:
            return "error:22"  # grbl 1.1, gcode.c: a feed rate that was never set
        self.blocks.append((target, feed / 60.0))
        self.target = target
        if self.state == "Idle":
            self.state = "Run"
        return ""

    def _move(self, left_s: float) -> None:
        if self.state not in {"Run", "Jog"}:
            return
        moved = bool(self.blocks)
        while self.blocks and left_s > 0.0:
            target, speed = self.blocks[0]
            speed *= self.overrides[0] / 100.0
            way = target - self.at
            need_s = float(np.linalg.norm(way)) / speed
            if need_s <= left_s:
                self.at = target.copy()
                self.blocks.popleft()
            else:
                self.at = self.at + way * (left_s / need_s)
            left_s -= need_s
        self.moved_to.append(self.at.copy())
        if moved and self.client is None:
            self.moves_since_lost += STEP_S
        if not self.blocks:
            self.state = "Idle"
