"""The other commands of the documents, each with what keeps it from the list of quick ones.

Times are of the processor, about.
"""

from __future__ import annotations

OF_TESTS = "the suite runs these tests"
NO_FIGURES = "shows how to ask; no figure stands for it"
THEIRS = "a design that is not part of this repository"
BENCH = "ratios of one run of one machine; benchmarks/results.json has them"

SLOW: dict[str, dict[str, str]] = {
    "results.md": {
        "threadline fastest examples/x-180.prg -m lathe-winder --interpolation linear --nominal": (
            "beside the others; tests/search/test_fastest.py"
        ),
        "threadline fastest examples/x-180.prg -m lathe-winder --interpolation NAME": (
            "a quarter of a minute to a minute each"
        ),
        "threadline fastest examples/cone-dome-cylinder.prg -m lathe-winder": "51 s",
        "python -m tools.long_winding LONG.nc": "writes the job of the command beside it",
        "threadline fastest LONG.nc -m lathe-winder": "a minute; tests/search/test_long_jobs.py",
        "make demo": "the command beside it is quick",
        "make bench": BENCH,
        "make fuzz": "hours",
        "python -m tools.fuzz --seed 317 --reader READER --cases N": "an hour for all readers",
        "python -m tools.fuzz --seed 1301 --reader NAME --cases 100000": "600 000 cases",
        "python -m tools.fuzz_commands --kind machine-number --seed 316": "14 291 commands",
        "python -m tools.fuzz_interrupts": "a second for each of 200 cases",
        "python -m tools.duration_against_contour": "four minutes, and toppra",
        "python -m tools.x_180_bound": "half a minute",
        "python -m tools.big_program 5000000 BIG.prg": "writes 197 MB",
        "/usr/bin/time -v threadline prove BIG.prg -m lathe-winder --interpolation NAME --json": (
            "253 s"
        ),
        "python -m tools.memory_bounds": "half an hour",
        "python -m tools.points_growth 3 5 --every-point "
        "--picture docs/pictures/points-growth.png": ("times and memory of one computer"),
        "python -m tools.points_growth 3 7 --picture docs/pictures/points-growth-chords.png": (
            "a minute; times and memory of one computer"
        ),
        "python -m tools.smoother_corners": "half a minute; what a path gains",
        "python -m tools.random_paths 1000 200000": "a minute",
        "python -m tools.random_paths 1000 300000": "a minute",
    },
    "results-stitcher.md": {
        "python -m tools.robust_corners examples/stitcher-robust.seam.toml "
        'src/threadline/machine/library/stitcher.spec.toml "100 %" 45': (
            "16 s; tests/test_robust_plan.py on two of the nine"
        ),
        "threadline prove examples/stitcher-robust-length.seam.toml -m stitcher "
        "-s examples/stitcher-place.spec.toml --feed-forward "
        '--robust "100 %" --ends "100 %" --nominal': (
            "17 s; tests/control/test_robust_averages.py on a mean speed"
        ),
        "pytest tests/twin/test_stitcher.py tests/twin/test_hybrid.py": OF_TESTS,
        "python -m tools.long_seam 1e6 FOLDER": "writes the job of the next",
        "threadline prove FOLDER/long.seam.toml -m stitcher --interpolation linear "
        "--nominal": "66 s",
        "python -m tools.stitcher_overshoots FILE.png": "tests/plant_analysis/test_overshoots.py",
        "threadline analyse NAME --experiments": "tests/plant_analysis/test_experiments.py",
        "threadline analyse NAME --json": "each NAME is run as one of the quick ones",
        "threadline analyse stitcher --axis X --report DIR": "a root locus, drawn",
        'threadline design examples/stitcher-steep.seam.toml -m stitcher --needle "75 stitch/s" '
        '--feed-forward --smoothing "20 ms, 22 ms, 24 ms"': "59 s",
        "threadline design examples/stitcher-test-path.seam.toml -m stitcher "
        "-s examples/stitcher-place.spec.toml --nominal --corners -o found.toml "
        "--report DIR": "103 s",
        "threadline design examples/stitcher-test-path.seam.toml -m stitcher "
        "-s examples/stitcher-place.spec.toml --nominal -o found.toml --report DIR": "54 s",
        "threadline fastest SEAM -m stitcher": "34 s",
        "threadline fastest SEAM -m stitcher --feed-forward": "minutes",
        "threadline fastest SEAM -m stitcher -s examples/stitcher-place.spec.toml --feed-forward "
        '--low "20 stitch/s" --mismatch --report DIR': "nine searches",
        "threadline prove SEAM -m found.toml": "of what design found",
        "threadline prove examples/stitcher-test-path.seam.toml -m examples/stitcher-75-place.toml "
        "--tolerances": "half a minute, 220 runs",
        "threadline prove examples/stitcher-75-rigid.seam.toml -m examples/stitcher-75-rigid.toml "
        '--feed-forward --smoothing "20 ms" --tolerances': "half a minute, 220 runs",
        "threadline prove examples/stitcher-even.seam.toml -m stitcher --feed-forward "
        '--robust "0 %"': "some ten seconds; tests/test_robust_plan.py",
        "threadline prove examples/stitcher-steep.seam.toml -m stitcher --feed-forward "
        '--smoothing "42 ms"': "its file is changed by hand for each needle speed",
    },
    "results-shaping.md": {
        "make bench": BENCH,
        "pytest tests/shaping/test_bands.py": OF_TESTS,
        "pytest tests/shaping/test_direct_unit.py": OF_TESTS,
        "python -m tools.shaper_results SECTION": "each section but `front` is quick",
        "python -m tools.shaper_results front": "integer programs, minutes",
        'threadline shaper --mode 3.04Hz --kind zv --move "200 mm" --acceleration "1 m/s^2" '
        '--tick "10 ms"': "a minute",
        "threadline shaper": NO_FIGURES,
        "threadline analyse MACHINE": NO_FIGURES,
        'threadline prove JOB -m MACHINE --shaper "zv:12.463Hz:0.0574"': NO_FIGURES,
        "threadline shaper --mode 3.04Hz --mode 9.1Hz --damping 0.009 --kind um-direct": NO_FIGURES,
        'threadline shaper --mode 3.04Hz --damping 0.17 --kind um-ei --tick "1 ms"': (
            "the section `rounding`, which is quick, has its figures"
        ),
    },
    "results-onoff.md": {
        "pytest tests/onoff tests/plc": OF_TESTS,
        "python -m tests.plc.scan_table": "minutes",
        "python -m tests.plc.stuck": "tests/plc/test_stuck.py",
        "python -m tests.plc.breaks --compiled FOLDER": "needs matiec; tests/plc/test_breaks.py",
        "python -m tools.onoff_results cycle": "a minute",
        "python -m tools.onoff_results levels": "minutes",
        "threadline compare examples/letter-cycle.toml -m letter-placer": "a minute",
        "threadline compile examples/letter-cycle.toml -m letter-placer --target st --shaper zv "
        '--mode "3.04 Hz" --damping 0.17 -o cycle.st': "tests/plc run what it writes",
        'threadline fastest examples/letter-cycle.toml -m MACHINE --band "20 %" -o robust.toml': (
            "half a minute"
        ),
        "threadline prove examples/letter-cycle.toml -m letter-placer+whole-scans+own-damping "
        "--shaper zv --report FOLDER": NO_FIGURES,
    },
    "results-embroidery.md": {
        'threadline prove DESIGN -m schiffli-frame --tolerance "0.05 mm"': THEIRS,
        "threadline prove DESIGN -m schiffli-frame": THEIRS,
        'threadline law --mode 12Hz --damping 0.02 --move "16.5 mm" --time "120 ms" '
        '--limit "6.33 m/s^2" --residual "0.05 mm" --band 0.3 --out wide.law.csv': (
            "it writes a file; tests/stitching/test_claim.py plays such a law"
        ),
        "threadline compare tree.dst -m schiffli-frame": THEIRS,
        "threadline fastest tree.dst -m schiffli-frame --nominal": THEIRS,
        "threadline fastest examples/rosette.dst -m schiffli-frame": "a minute",
        "OPENBLAS_NUM_THREADS=1 threadline prove CARD -m schiffli-frame": "random cards, minutes",
        "python -m tools.fuzz --reader design-hus --cases 100000": "minutes",
        "python -m tools.schiffli_claim": "tests/stitching/test_claim.py",
    },
    "yield.md": {
        "python -m tools.yield_against_speed winder": "ten minutes",
        "python -m tools.yield_against_speed stitcher": "five minutes",
        'threadline yield examples/x-180.prg -m lathe-winder --variants 2000 --at-least "99 %"': (
            "40 s"
        ),
        "threadline fastest examples/x-180.prg -m lathe-winder --interpolation linear --yield "
        '"95 %"': "a minute",
    },
}
