"""Try a wheel in a bare virtual environment: ``python -m tools.try_wheel FILE``.

It is installed with the locked requirements and nothing else, and used in a folder that holds one
job. What is looked for is what a checkout would hide: a file that the wheel lacks, a package that
is not declared.
"""

from __future__ import annotations

import argparse
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.request
import venv
from collections.abc import Sequence
from pathlib import Path
from urllib.parse import urljoin

ROOT = Path(__file__).resolve().parent.parent
MACHINE = "lathe-winder"
JOB = "x-180.prg"
_STARTS_S = 300.0  # the first panel on a slow computer


def installed(wheel: Path, folder: Path) -> Path:
    """Return the folder of the programs of a new environment that holds the wheel."""
    venv.create(folder, with_pip=True)
    programs = folder / "bin"
    pip: list[str | Path] = [programs / "python", "-m", "pip", "install", "--quiet"]
    locked = ROOT / "requirements" / "run.txt"
    subprocess.run([*pip, "--require-hashes", "-r", locked], check=True)
    subprocess.run([*pip, "--no-deps", wheel], check=True)
    subprocess.run([programs / "python", "-m", "pip", "check"], check=True)
    return programs


def output_of(program: Sequence[str | Path], folder: Path) -> str:
    """Return what a program prints; one that fails ends this one."""
    print("+", *(Path(word).name for word in program), flush=True)
    done = subprocess.run(program, cwd=folder, check=True, stdout=subprocess.PIPE, text=True)
    return done.stdout


def read(url: str) -> str:
    """Return what a server answers."""
    with urllib.request.urlopen(url, timeout=30) as answer:
        return str(answer.read().decode("utf-8"))


def try_panel(threadline: Path, folder: Path) -> None:
    """Start the panel, read its page with all that the page names, and end it by Ctrl-C."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    url = f"http://127.0.0.1:{port}/"
    print("+ threadline panel", flush=True)
    panel = subprocess.Popen([threadline, "panel", "-m", MACHINE, "--port", str(port)], cwd=folder)
    try:
        page, end = "", time.monotonic() + _STARTS_S
        while not page and time.monotonic() < end and panel.poll() is None:
            try:
                page = read(url)
            except (urllib.error.URLError, ConnectionError):
                time.sleep(0.5)
        named = [word for word in page.split('"') if word.endswith((".js", ".css"))]
        sizes = {name: len(read(urljoin(url, name))) for name in named}
        if not sizes or not all(sizes.values()):
            sys.exit(f"the panel of the wheel serves no whole page: {page[:200]!r}, {sizes}")
        panel.send_signal(signal.SIGINT)
        if panel.wait(timeout=60):
            sys.exit(f"the panel ended with {panel.returncode}")
    finally:
        panel.kill()
        panel.wait()


def main(arguments: Sequence[str] | None = None) -> None:
    """Install the wheel, and use it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("wheel", type=Path, help="the file of the wheel")
    wheel = parser.parse_args(arguments).wheel.resolve()
    version = wheel.name.split("-")[1]
    with tempfile.TemporaryDirectory(prefix="threadline-wheel-") as made:
        folder = Path(made) / "work"
        folder.mkdir()
        shutil.copy(ROOT / "examples" / JOB, folder)
        programs = installed(wheel, Path(made) / "environment")
        threadline = programs / "threadline"
        python = programs / "python"
        for program in ([threadline], [python, "-m", "threadline"]):
            if output_of([*program, "--version"], folder).strip() != version:
                sys.exit(f"{program} is not of version {version}")
        if MACHINE not in output_of([threadline, "machines"], folder):
            sys.exit("the wheel has no library of machines")
        linear = ["prove", JOB, "-m", MACHINE, "--interpolation", "linear", "--nominal"]
        print(output_of([threadline, *linear, "--report", "report"], folder).splitlines()[-1])
        output_of([threadline, "new", "winder", "mine"], folder)
        try_panel(threadline, folder)
    print(f"{wheel.name} works in a bare environment")


if __name__ == "__main__":
    main()
