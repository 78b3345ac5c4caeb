"""The start of the program: imports, and an interrupt before anything runs."""

from __future__ import annotations

import json
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from threadline.cli.lazy import COMMANDS
from threadline.cli.main import app

INTERRUPTING = """
import os, signal, sys
# Whoever runs the tests in the background may have told it to ignore interrupts.
signal.signal(signal.SIGINT, signal.default_int_handler)
class Interrupter:
    def find_spec(self, name, path=None, target=None):
        if name == {name!r}:
            os.kill(os.getpid(), signal.{signal})
            import time; time.sleep(5)
sys.meta_path.insert(0, Interrupter())
signal.signal(signal.SIGHUP, signal.SIG_DFL)  # under nohup it is ignored, and stays so
sys.argv = ["threadline", "law", "cubic"]
from threadline.cli.start import run
run()
"""


def run(code: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=120
    )


@pytest.mark.parametrize(
    ("signal", "status", "message"),
    [("SIGINT", 130, "interrupted"), ("SIGTERM", 143, "terminated"), ("SIGHUP", 129, "hung up")],
)
@pytest.mark.parametrize("name", ["typer", "threadline.cli.law", "numpy"])
def test_an_interrupt_while_importing_is_one_line(
    name: str, signal: str, status: int, message: str
) -> None:
    """While the command line, a command, or a package that the command needs is imported."""
    done = run(INTERRUPTING.format(name=name, signal=signal))
    assert (done.returncode, done.stdout) == (status, "")
    assert done.stderr == f"error: {message}; nothing was left half-written\n"


@pytest.mark.parametrize("name", ["typer", "threadline.cli.law"])
def test_interrupts_on_top_of_each_other_are_one_line(name: str) -> None:
    """The second comes after the line was written and before the process has ended."""
    more = (
        "write = os.write\n"
        "def twice(number, data):\n"
        "    write(number, data)\n"
        "    os.kill(os.getpid(), signal.SIGINT)\n"
        "    return os.kill(os.getpid(), signal.SIGTERM)\n"
        "os.write = twice\n"
    )
    code = INTERRUPTING.format(name=name, signal="SIGINT")
    done = run(code.replace("sys.meta_path", more + "sys.meta_path"))
    assert (done.returncode, done.stdout) == (130, "")
    assert done.stderr == "error: interrupted; nothing was left half-written\n"


def test_an_interrupt_after_the_line_of_another_says_nothing() -> None:
    """After the command, while the interpreter ends."""
    done = run(
        "import os, signal, sys\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "from threadline.cli import main, start\n"
        "main._flush = lambda: os.kill(os.getpid(), signal.SIGINT)\n"
        "end = main.sys.exit\n"
        "def late(status):\n    os.kill(os.getpid(), signal.SIGINT)\n    end(status)\n"
        "main.sys.exit = late\n"
        "sys.argv = ['threadline', 'law', 'cubic', '--json']\n"
        "start.run()\n"
    )
    assert done.returncode == 130
    assert done.stderr == "error: interrupted; nothing was left half-written\n"


def test_an_interrupt_behind_the_files_says_that_they_are_there(tmp_path: Path) -> None:
    """While a command reports its files: they stay."""
    done = run(
        "import os, signal, sys, time\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "from threadline.cli import main, start\n"
        "main._flush = lambda: os.kill(os.getpid(), signal.SIGINT)\n"
        f"sys.argv = ['threadline', 'new', 'winder', {str(tmp_path / 'mine')!r}]\n"
        "start.run()\n"
    )
    assert done.returncode == 130
    assert done.stderr == "error: interrupted; its files are written completely\n"
    assert (tmp_path / "mine" / "machine.toml").stat().st_size > 1000


@pytest.mark.parametrize("then", ["time.sleep(60)", "raise RuntimeError('no object')"])
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_an_interrupt_that_a_call_of_machine_code_drops_is_answered(name: str, then: str) -> None:
    """Like numba's compiler: it calls Python, drops the raised exception, and fails."""
    done = run(
        "import ctypes, os, signal, sys, time\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "from threadline.cli import main, start\n"
        f"def called():\n    os.kill(os.getpid(), signal.{name})\n    time.sleep(60)\n"
        f"def work(*_, **__):\n    ctypes.CFUNCTYPE(None)(called)()\n    {then}\n"
        "main.app = work\n"
        "sys.argv = ['threadline', 'law', 'cubic']\n"
        "start.run()\n"
    )
    status, reason = {"SIGINT": (130, "interrupted"), "SIGTERM": (143, "terminated")}[name]
    assert (done.returncode, done.stdout) == (status, "")
    assert done.stderr == f"error: {reason}; nothing was left half-written\n"


def test_help_imports_nothing_heavy() -> None:
    """``threadline --help`` needs typer and no array, so it answers at once."""
    done = run(
        "import sys\n"
        "from threadline.cli.main import main\n"
        "try:\n    main(['--help'])\n"
        "except SystemExit:\n    pass\n"
        "heavy = {'numpy', 'scipy', 'numba', 'pint', 'pydantic', 'matplotlib'} & set(sys.modules)\n"
        "sys.exit(f'imported {heavy}' if heavy else 0)\n"
    )
    assert (done.returncode, done.stderr) == (0, "")
    listed = [line.split()[0] for line in done.stdout.splitlines() if line.startswith("  ")]
    assert [name for name in listed if name in COMMANDS] == list(COMMANDS)


def test_the_help_of_a_command_lists_its_options_by_purpose() -> None:
    """An operator finds the options of the job without reading all planning options."""
    lines = CliRunner().invoke(app, ["prove", "--help"]).output.splitlines()
    titles = [line for line in lines if line.endswith(":") and not line.startswith(" ")]
    assert titles == [
        "Arguments:", "Input files:", "Planning:", "Level of the verdict:",
        "Where machines are judged:", "Options of this command:",
    ]  # fmt: skip
    section = {
        line.split()[0].rstrip(","): max(k for k, title in enumerate(lines[:at]) if title in titles)
        for at, line in enumerate(lines)
        if line.startswith("  -")
    }
    of = {name: lines[at] for name, at in section.items()}
    assert of["-m"] == "Input files:"
    assert of["--feed"] == "Planning:"
    assert of["--tolerances"] == "Level of the verdict:"
    assert of["--report"] == "Options of this command:"


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_of_the_table_is_there(name: str) -> None:
    """The module adds one command with this name, a help and an example."""
    app = typer.Typer()
    import_module(f"threadline.cli.{COMMANDS[name].module}").register(app)
    (command,) = app.registered_commands
    assert command.name == name
    assert command.callback is not None
    assert f"Example: threadline {name}" in (command.callback.__doc__ or "")


def test_the_module_runs_as_the_command_does() -> None:
    """``python -m threadline`` if the scripts of the environment are not on the path."""
    made = subprocess.run(
        [sys.executable, "-m", "threadline", "law", "cubic", "--json"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (made.returncode, made.stderr) == (0, "")
    assert json.loads(made.stdout)["name"] == "cubic"


def test_the_machines_of_the_library_are_read_without_a_registry_of_units() -> None:
    """Loading it takes a quarter of a second in each process of the program."""
    done = run(
        "import sys\n"
        "from threadline.machine.load import library_names, load_machine\n"
        "from threadline.proof.option_words import parse_feed\n"
        "from threadline.verdict import load_spec\n"
        "for name in library_names():\n"
        "    load_spec(None, load_machine(name))\n"
        "parse_feed('20 mm/s')\n"
        "sys.exit('imported pint' if 'pint' in sys.modules else 0)\n"
    )
    assert (done.returncode, done.stderr) == (0, "")


OF_STUDIES = {"matplotlib", "scipy.stats", "scipy.optimize", "scipy.interpolate"}
FOR_FEW = OF_STUDIES | {"scipy.special", "scipy.ndimage", "scipy.signal", "sqlalchemy", "mcap"}
FOR_FEW |= {"jinja2", "threadline.search", "threadline.live.store", "threadline.live"}
UNUSED = {
    "panel.thinned_traces": OF_STUDIES | {"pint", "numba", "scipy.linalg"},
    "cli.prove": FOR_FEW,
    "cli.fastest": OF_STUDIES,
    "cli.yield_": OF_STUDIES,
    "panel.owner_process": OF_STUDIES | {"sqlalchemy"},
    "cli.panel_": OF_STUDIES | {"sqlalchemy"},
    "cli.run_": OF_STUDIES | {"sqlalchemy"},
}
"""What each module does not load; each is loaded behind those above it, which load less."""


def test_a_module_loads_no_library_that_it_seldom_uses() -> None:
    """Pictures and statistics take a second to load; reading a trace compiles nothing.

    A proof uses only the linear algebra of scipy: special functions and filters took a third of its
    start. All checks run in one process: a load is charged to the module, or to one before it.
    """
    done = run(
        "import sys\n"
        "from importlib import import_module\n"
        f"for module, unused in {UNUSED!r}.items():\n"
        "    import_module(f'threadline.{module}')\n"
        "    heavy = sorted(unused & set(sys.modules))\n"
        "    if heavy:\n        sys.exit(f'{module} imported {heavy}')\n"
        "    print(module)\n"
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.split() == [*UNUSED]


def test_a_simulated_machine_is_served_without_jobs_and_judges() -> None:
    unused = OF_STUDIES | {"pint", "threadline.jobs", "threadline.verdict"}
    done = run(
        "import sys\n"
        "import threadline.live.sim_process\n"
        f"heavy = sorted({unused!r} & set(sys.modules))\n"
        "sys.exit(f'imported {heavy}' if heavy else 0)\n"
    )
    assert (done.returncode, done.stderr) == (0, "")


PLANNING = {
    "threadline.proof.pipeline",
    "threadline.jobs",
    "threadline.motion.path",
    "threadline.motion.timing",
}
SIMULATING = {"threadline.twin", "threadline.verdict", "threadline.commands", "threadline.report"}
SERVING = {"threadline.panel", "threadline.live.store", "threadline.live", "threadline.search"}
SERVING |= {"fastapi", "uvicorn", "sqlalchemy", "mcap", "matplotlib", "jinja2"}
OF_ARRAYS = {"scipy.linalg", "scipy.special", "scipy.optimize", "numba"}


@pytest.mark.parametrize(
    ("given", "unused"),
    [
        (
            ["law", "--help"],
            {"threadline.machine", "threadline.motion.shaping", "pint", "rich", "scipy"},
        ),
        (
            ["law", "cubic", "--json"],
            {"threadline.machine", "threadline.motion.shaping", "pint", "rich"},
        ),
        (
            ["machines", "--json"],
            {"threadline.dynamics", "threadline.motion.shaping", "threadline.motion.laws"},
        ),
        (["size", "--help"], {"threadline.machine", "threadline.motion.shaping", "rich"}),
    ],
    ids=["law --help", "law cubic", "machines", "size --help"],
)
def test_a_command_that_plans_nothing_loads_nothing_that_does(
    given: list[str], unused: set[str]
) -> None:
    """The whole pipeline takes two seconds to load, numba and linear algebra one of them."""
    unused = unused | PLANNING | SIMULATING | SERVING | OF_ARRAYS
    done = run(
        "import sys\n"
        "from threadline.cli.main import main\n"
        f"try:\n    main({given!r})\n"
        "except SystemExit as ended:\n    assert not ended.code\n"
        f"heavy = sorted({unused!r} & set(sys.modules))\n"
        "sys.exit(f'imported {heavy}' if heavy else 0)\n"
    )
    assert (done.returncode, done.stderr) == (0, "")


def test_no_garbage_is_looked_for_among_what_is_imported() -> None:
    """Neither while a command is imported nor afterwards; its own objects are collected."""
    done = run(
        "import gc\n"
        "passes = []\n"
        "gc.callbacks.append(lambda phase, info: passes.append(info['generation']))\n"
        "from threadline.cli import lazy\n"
        "from threadline.cli.main import app\n"
        "from typer.main import get_command\n"
        "gc.collect()\n"  # or a collection that earlier objects have nearly caused would count
        "passes.clear()\n"
        "real = lazy.import_module\n"
        "lazy.import_module = lambda name: (real(name), print(passes))[0]\n"
        "get_command(app).get_command(None, 'prove')\n"
        "print(gc.isenabled(), gc.get_freeze_count() > 50_000)\n"
    )
    assert (done.stdout, done.stderr) == ("[]\nTrue True\n", "")


@pytest.mark.parametrize(
    ("environment", "counted"), [({}, "1"), ({"OPENBLAS_NUM_THREADS": "3"}, "3")]
)
def test_matrices_are_multiplied_by_one_thread(environment: dict[str, str], counted: str) -> None:
    """Unless the shell says otherwise: results do not depend on the number of cores."""
    done = run(
        "import os, sys\n"
        "os.environ.pop('OPENBLAS_NUM_THREADS', None)\n"
        f"os.environ.update({environment!r})\n"
        "sys.argv = ['threadline', '--version']\n"
        "from threadline.cli.start import run\n"
        "try:\n    run()\nexcept SystemExit:\n    pass\n"
        "print(os.environ['OPENBLAS_NUM_THREADS'], 'numpy' in sys.modules)\n"
    )
    assert done.stdout.splitlines()[-1] == f"{counted} False"


def test_the_shells_backend_of_drawings_is_none_of_ours() -> None:
    """A report is drawn into files, and matplotlib fails with an unknown backend."""
    done = run(
        "import os, sys\n"
        "os.environ['MPLBACKEND'] = 'foo'\n"
        "sys.argv = ['threadline', '--version']\n"
        "from threadline.cli.start import run\n"
        "try:\n    run()\nexcept SystemExit:\n    pass\n"
        "import matplotlib\n"
        "print(matplotlib.get_backend())\n"
    )
    assert done.stdout.splitlines()[-1] == "agg", done.stderr
