"""``python -m threadline``: the same program as the command ``threadline``."""

from __future__ import annotations

from threadline.cli.start import run

if __name__ == "__main__":
    run()
