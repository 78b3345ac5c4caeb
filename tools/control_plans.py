"""Controllers and plans on the same job: what stands in the table of ``docs/control.md``.

Every machine is written by ``threadline control`` and proven like any other. A needle is set to the
lag of the head, as that of the library's specification is: to the whole ms at which the largest
error of the stitch length is least.
"""

from __future__ import annotations

import contextlib
import io
import re
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import threadline as tl
from threadline.cli.main import main as threadline

ROOT = Path(__file__).resolve().parent.parent
SEAM = ROOT / "examples" / "stitcher-test-path.seam.toml"
SPEC = ROOT / "examples" / "stitcher-place.spec.toml"
CIRCUIT = ROOT / "examples" / "cone-dome-cylinder.prg"
LAGS_MS = range(10, 44)

STITCHER: dict[str, tuple[str, dict[str, Any]]] = {
    "lead": ("", {}),
    "cross-coupled": ("cross-coupled --coupling 50%", {}),
    "lqg": ("lqg --gain 2", {}),
    "preview-4": ("preview --gain 2 --ahead 4", {}),
    "preview-30": ("preview --gain 2 --ahead 30", {}),
    "zpetc": ("zpetc --smoothing 7", {}),
    "feed-forward": ("", {"feed_forward": True}),
    "robust": ("", {"feed_forward": True, "robust": "100 %"}),
}
WINDER: dict[str, tuple[str, dict[str, Any]]] = {
    "pd": ("", {}),
    "cross-coupled": ("cross-coupled --axes A,X --coupling 50%", {}),
    "lqg": ("lqg --gain 4", {}),
    "preview-4": ("preview --gain 4 --ahead 4", {}),
    "zpetc": ("zpetc", {}),
    "pd-optimal": ("", {"interpolation": "optimal"}),
    "feed-forward": ("", {"interpolation": "optimal", "feed_forward": True}),
}
"""By name: words of ``threadline control``, none for the machine as it is; options of the plan."""


def designed(machine: str, words: str, folder: Path) -> str:
    """Return the machine with a design, written into a folder."""
    if not words:
        return machine
    file = folder / "designed.toml"
    name, *rest = words.split()
    with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):
        threadline(["control", machine, "--design", name, *rest, "-o", str(file), "--json"])
    return str(file)


def figures(proved: Any) -> dict[str, float]:
    """Return the figures of the table."""
    found: dict[str, float] = {}
    for result in proved.verdict.results:
        if result.measured is not None:
            found[result.name] = max(found.get(result.name, 0.0), result.measured)
    names = {
        "contour_m": "contour_error", "length": "stitch_length_error",
        "settling_s": "settling_time", "rms_a": "current_rms", "peak_a": "current_peak",
    }  # fmt: skip
    figures = {key: found[name] for key, name in names.items() if name in found}
    return figures | {"duration_s": proved.json()["duration_s"]}


def control_stitcher(name: str, needle: str) -> dict[str, float]:
    """Return the figures of a controller or plan on the thesis's test path.

    ``worst_`` is before those of the worst of nine machines: the file's, and those with masses and
    stiffnesses at the ends of their tolerances.
    """
    words, options = STITCHER[name]
    text = SPEC.read_text(encoding="utf-8")
    options = options | {"needle": f"{needle} stitch/s", "level": "nominal"}
    with TemporaryDirectory() as kept:
        spec = Path(kept) / "spec.toml"
        machine = designed("stitcher", words, Path(kept))

        def at(lag: int, **more: Any) -> dict[str, float]:
            spec.write_text(re.sub(r'delay = "\d+ ms"', f'delay = "{lag} ms"', text))
            proved = tl.prove(SEAM, machine, spec=spec, **options, **more)
            return figures(proved) | {"lag_s": 1e-3 * lag}

        lags = [18] if options.get("feed_forward") else LAGS_MS
        best = min((at(lag) for lag in lags), key=lambda found: found["length"])
        worst = at(round(1e3 * best["lag_s"]), ends="100 %")
    return best | {f"worst_{key}": worst[key] for key in ("contour_m", "length")}


def control_fastest(name: str, lag_ms: str) -> dict[str, float]:
    """Return the fastest needle of a controller on the test path by place and length."""
    text = SPEC.read_text(encoding="utf-8")
    with TemporaryDirectory() as kept:
        spec = Path(kept) / "spec.toml"
        spec.write_text(re.sub(r'delay = "\d+ ms"', f'delay = "{lag_ms} ms"', text))
        machine = designed("stitcher", STITCHER[name][0], Path(kept))
        return {"best": tl.fastest(SEAM, machine, spec=spec, level="nominal").best or 0.0}


def control_winder(name: str, feed: str) -> dict[str, float]:
    """Return the figures of a controller or plan on the thesis's circuit, at counts per tick."""
    words, options = WINDER[name]
    options = {"interpolation": "auto"} | options
    with TemporaryDirectory() as kept:
        machine = designed("lathe-winder", words, Path(kept))
        return figures(
            tl.prove(CIRCUIT, machine, feed=f"{feed} count/tick", level="nominal", **options)
        )
