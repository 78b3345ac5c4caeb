import { describe, expect, it } from "vitest";
import { bandOf, pace, sewnUntil } from "../src/cloth";
import { watched } from "../src/margins";
import type { Criterion, Cylinder, Figures, Progress } from "../src/messages";
import type { Shown } from "../src/picture";
import { pictured } from "../src/run_picture";
import { ofWay, others, toldBy } from "../src/scheme";
import { isOn, pieces, plannedAt, rowsOf, spans, thinned } from "../src/steps";
import { type Kept, matches } from "../src/traces";
import { counts } from "../src/verdict";
import { roundly } from "../src/view3d";
import { unknownPlace, whyUnknown } from "../src/wording";

describe("spans of an output", () => {
  it("begin and end where it changes, the last at the end of the plan", () => {
    expect(spans(false, [1, 2, 5], 8)).toEqual([
      [1, 2],
      [5, 8],
    ]);
    expect(spans(true, [], 8)).toEqual([[0, 8]]);
    expect(spans(true, [0, 3, 8], 8)).toEqual([[3, 8]]);
  });
});

describe("names of steps", () => {
  it("stand beside each other where there is room, else below each other", () => {
    expect(rowsOf(["start", "cut", "lift"], [0, 100, 200])).toEqual([0, 0, 0]);
    expect(rowsOf(["start", "descend", "cut", "lift"], [0, 20, 40, 60])).toEqual([0, 1, 2, 0]);
  });
});

describe("a move round a mandrel", () => {
  it("is drawn round it: with places between its ends", () => {
    expect(roundly([{ A: 0, X: 0 }], "A")).toEqual([{ A: 0, X: 0 }]);
    const found = roundly(
      [
        { A: 0, X: 0 },
        { A: 1, X: 2 },
        { A: 1, X: 3 },
      ],
      "A",
    );
    expect(found).toHaveLength(22);
    expect(found[10]).toEqual({ A: 0.5, X: 1 });
    expect(found[21]).toEqual({ A: 1, X: 3 });
  });
});

describe("the colour of a stitch", () => {
  it("changes at half of the limit, at 80 %, and beyond the limit", () => {
    expect([0, 0.5, 0.51, 0.8, 1, 1.01].map(bandOf)).toEqual([0, 0, 1, 1, 2, 3]);
  });
});

describe("the pace of a design", () => {
  it("is that of the stitch under way, by the plan and the override; unknown without times", () => {
    const design = { times_s: [0, 0.5, 1.5, 2], number: [1, 2, 3, 7] };
    expect([-1, 0, 1, 3].map((k) => pace(design, k, 100))).toEqual([120, 120, 60, 480]);
    expect(pace(design, 1, 50)).toBe(30);
    expect(pace({ times_s: [], number: [1] }, 0, 100)).toBeNull();
  });
});

describe("what is sewn", () => {
  it("ends where a run is, or was broken off; another program's run sews nothing of it", () => {
    const run = (ended: string | null, file = "rosette.dst") =>
      ({ program: "a rose", file, ended, time_s: 7 }) as unknown as Progress;
    const job = { program: "rosette.dst", times_s: [0, 10] };
    expect([null, "stopped", "fault"].map((ended) => sewnUntil(run(ended), job))).toEqual([7, 7, 7]);
    expect(sewnUntil(run("completed"), job)).toBeNull();
    expect(sewnUntil(run("stopped", "badge.dst"), job)).toBeNull();
    expect(sewnUntil(run(null), { program: "rosette.dst", times_s: [] })).toBeNull();
    expect([sewnUntil(null, job), sewnUntil(run(null), null)]).toEqual([null, null]);
  });
});

describe("the filter of runs", () => {
  const run: Kept = {
    run: "2026-11-29-there",
    started: "",
    job: "there.prg",
    ended: "stopped",
    text: "by the operator",
    verdict: "not proven",
  };
  it("has every word, in any case, and the verdict", () => {
    expect(matches(run, "", "")).toBe(true);
    expect(matches(run, "THERE stopped", "")).toBe(true);
    expect(matches(run, "there fault", "")).toBe(false);
    expect(matches(run, "", "in spec")).toBe(false);
    expect(matches({ ...run, verdict: "in spec" }, "", "trouble")).toBe(false);
  });
});

describe("what an operator watches", () => {
  it("is where tool or stitch are, the most used limit first", () => {
    const of = (name: string, measured: number) => ({ name, axis: "", measured, limit: 1, unit: "m" });
    const found = watched([
      of("velocity", 0.9),
      of("contour_error", 0.3),
      of("seam_error", 0.4),
    ] as Criterion[]);
    expect(found.map((one) => one.name)).toEqual(["seam_error", "contour_error"]);
  });
});

describe("a machine with cylinders", () => {
  const x: Cylinder = {
    name: "X",
    unit: "m",
    stroke: 0.2,
    forward: ["x_right", "x_right_a1", "choke"],
    back: ["x_left"],
    contacts: [{ name: "x_is_left", at: 0.006, beyond: "below" }],
  };
  it("names a flow control without its valve, where it has its name", () => {
    expect(ofWay(x.forward)).toEqual(["x right", "a1", "choke"]);
    expect(ofWay([])).toEqual([]);
  });
  it("shows each signal once: at its cylinder, else in a list", () => {
    const all = ["x_is_left", "light_grid", "x_right", "x_right_a1", "choke", "x_left", "knife"];
    expect(others([x], all)).toEqual(["light_grid", "knife"]);
  });
  it("is simulated with its plan: places and signals at a time", () => {
    const lane = { name: "knife", input: false, on: false, changes_s: [1, 2] };
    expect([0.9, 1, 1.9, 2].map((time) => isOn(lane, time))).toEqual([false, true, true, false]);
    expect(isOn({ ...lane, on: true }, 1.5)).toBe(false);
    const job = { planned: { X: [0, 0.1, 0.2] }, times_s: [0, 1, 2], lanes: [lane] } as unknown as Shown;
    expect(plannedAt(job, 1.5)).toEqual({ at: { X: 0.1 }, on: { knife: true }, homed: true });
  });
  it("has curves in pieces that meet, without points that no pixel tells apart", () => {
    const points = [0, 0.4, 0.9, 1.2, 2.4, 3.6, 5].map((x): [number, number] => [x, 0]);
    expect(thinned(points).map(([x]) => x)).toEqual([0, 1.2, 2.4, 3.6, 5]);
    expect(
      thinned([
        [0, 0],
        [0.1, 2],
      ]),
    ).toHaveLength(2);
    expect(pieces(thinned(points), 2)).toEqual(["0.0,0.0 1.2,0.0 2.4,0.0", "2.4,0.0 3.6,0.0 5.0,0.0"]);
    expect(pieces([[0, 0]])).toEqual([]);
  });
  it("says in words why a place is not known", () => {
    const told = (state: string) => toldBy({ state, axes: { X: { load: null } }, signals: {} } as never);
    expect(told("disabled")).toEqual({ at: {}, on: {}, homed: false });
    expect(told("idle").homed).toBe(true);
    expect([unknownPlace(false), unknownPlace(true)]).toEqual(["not homed", "told in a run"]);
    expect(whyUnknown(false)).toContain("press Enable, then Home all");
  });
  it("has steps in its verdict, a seam stitches, a part program circuits and points", () => {
    const found = { stitches: null, steps: [], circuits: null, points: 6 } as unknown as Figures;
    expect(counts(found)).toEqual([["points", "6"]]);
    expect(counts({ ...found, circuits: 3 })).toEqual([
      ["circuits", "3"],
      ["points", "6"],
    ]);
    expect(counts({ ...found, steps: [{ name: "a", line: 1, begin_s: 0 }] })).toEqual([["steps", "1"]]);
    expect(counts({ ...found, stitches: { count: 9 } as Figures["stitches"] })).toEqual([["stitches", "9"]]);
  });
});

describe("the picture of a run", () => {
  const axis = (...actual: number[]) => ({ commanded: actual, actual, measured: true });
  it("is its way from above, in one scale and in the middle", () => {
    const found = pictured({ times_s: [0, 1, 2], axes: { X: axis(0, 0.1, 0.1), Y: axis(0, 0, 0.1) } });
    expect(found).toEqual({ points: "34.0,30.0 62.0,30.0 62.0,2.0", label: "its way in X and Y" });
  });
  it("is an axis over the time where it does not go both ways, X before others", () => {
    const still = axis(1, 1, 1);
    const found = pictured({ times_s: [0, 1, 2], axes: { A: axis(0, 1, 2), X: axis(0, 1, 0), Y: still } });
    expect(found).toEqual({ points: "2.0,30.0 48.0,2.0 94.0,30.0", label: "X over the time" });
    expect(pictured({ times_s: [0, 1], axes: { A: axis(0, 1), X: axis(2, 2) } })!.label).toBe(
      "A over the time",
    );
    expect(pictured({ times_s: [0], axes: { X: axis(3) } })).toBeNull();
  });
  it("has no more points than it can show, and ends where the run ended", () => {
    const many = [...Array(5000).keys()];
    const { points } = pictured({ times_s: many, axes: { X: axis(...many) } })!;
    expect(points.split(" ").length).toBeLessThan(170);
    expect(points.endsWith("94.0,2.0")).toBe(true);
  });
});
