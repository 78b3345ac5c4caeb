import { describe, expect, it } from "vitest";
import { bandOf } from "../src/cloth";
import { watched } from "../src/margins";
import type { Criterion } from "../src/messages";
import { spans } from "../src/steps";
import { type Kept, matches } from "../src/traces";

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

describe("the colour of a stitch", () => {
  it("changes at half of the limit, at 80 %, and beyond the limit", () => {
    expect([0, 0.5, 0.51, 0.8, 1, 1.01].map(bandOf)).toEqual([0, 0, 1, 1, 2, 3]);
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
