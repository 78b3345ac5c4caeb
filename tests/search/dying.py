"""A judge whose machines kill every worker that judges them."""

from __future__ import annotations

import os


class Deadly:
    def answer(self, item: int, _done: object = None) -> int:
        os._exit(9 + item)

    def machines(self, _item: int) -> int:
        return 1

    def known(self) -> bytes:
        return b"known"
