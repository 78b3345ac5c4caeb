"""Run every comparison and write ``benchmarks/results.json``.

A peer that is not installed is reported as an entry without a value, never left out. Times on a
shared machine are noisy: ours and the peer's are measured in one run, and only the ratio counts.
"""

from __future__ import annotations

import argparse
import importlib
import json
import pkgutil
import platform
import sys
from pathlib import Path

import benchmarks
import threadline

RESULTS = Path(__file__).parent / "results.json"


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    names = sorted(m.name for m in pkgutil.iter_modules(benchmarks.__path__) if m.name[0] != "_")
    parser.add_argument("only", nargs="*", choices=[*names, []], help="run these alone")
    chosen = parser.parse_args().only or names
    results = []
    for name in chosen:
        print(f"-- {name}", flush=True)
        for entry in importlib.import_module(f"benchmarks.{name}").run():
            results.append(entry)
            ratio = "     no peer" if entry["peer_value"] is None else "    no ratio"
            if entry["ratio"] is not None:
                ratio = f"{entry['ratio']:10.3g} x"
            print(f"   {ratio}  {entry['name']}: {entry['note']}", flush=True)
    if chosen == names:
        temporary = RESULTS.with_suffix(".json.part")
        temporary.write_text(json.dumps(results, indent=2, allow_nan=False) + "\n")
        temporary.replace(RESULTS)
        print(f"{len(results)} entries in {RESULTS}")
    print(f"threadline {threadline.__version__}, Python {platform.python_version()}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
