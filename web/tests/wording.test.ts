import { describe, expect, it } from "vitest";
import { feedOf, placeInWords } from "../src/bar";
import { extentInWords } from "../src/extent";
import type { Criterion, Figures, Progress, State } from "../src/messages";
import { toldEnd } from "../src/session";
import {
  amount,
  before,
  clock,
  inTrouble,
  nearest,
  sentence,
  timeOfDay,
  used,
  verdictOfRun,
  verdictWords,
  worst,
} from "../src/wording";

const criterion = (words: Partial<Criterion>): Criterion => ({
  name: "contour_error",
  axis: "",
  step: "",
  measured: 0.00045,
  limit: 0.0005,
  unit: "m",
  status: "passed",
  time_s: null,
  job_line: null,
  passes: [],
  operation: null,
  position: null,
  run: null,
  of: "run",
  required: false,
  note: "",
  ...words,
});

describe("what a program has", () => {
  const unit = (name: string): [number, string] => (name === "A" ? [180 / Math.PI, "°"] : [1000, "mm"]);
  const none = { planned: {}, moves: 0, stitches: null, steps: [] };

  it("is its moves or steps and the way of each axis", () => {
    const planned = { A: [0, Math.PI], X: [-0.01, 0.06, 0.02] };
    expect(extentInWords({ ...none, planned, moves: 3 }, unit)).toBe(
      "3 moves; A 0.0 to 180.0 °, X -10.0 to 60.0 mm",
    );
    const steps = [{ name: "cut", begin_s: 0, line: 1 }];
    expect(extentInWords({ ...none, planned: { X: [0, 0.2] }, steps }, unit)).toBe(
      "1 step; X 0.0 to 200.0 mm",
    );
    expect(extentInWords(none, unit)).toBe("0 moves");
  });
  it("is the size of a work that is sewn, and its threads", () => {
    const stitches = { x: [0, 0.05], y: [0.01, 0.03], count: 185, threads: [null, "#f00"] };
    expect(extentInWords({ ...none, stitches: stitches as unknown as Figures["stitches"] }, unit)).toBe(
      "185 stitches, 50.0 x 20.0 mm, 2 threads",
    );
  });
});

describe("the end of a run", () => {
  it("says once who stopped it, and no number that nobody knows", () => {
    const verdict = "NOT PROVEN (nominal: 1 run): the run ended in operation 177, stopped by the operator";
    const progress = { ended: "stopped", why: "stopped by the operator", verdict } as Progress;
    expect(toldEnd({ progress, axes: {} } as State)).toBe(
      "stopped by the operator. NOT PROVEN: it did not reach its end",
    );
  });
  it("says where nothing was measured, in place of the criteria that were not", () => {
    const lacks = "contour error and progress error were not measured";
    const verdict = `NOT PROVEN (nominal: 1 run): ${lacks}; Judged as one with what 7 did`;
    const progress = { ended: "completed", why: "", verdict } as Progress;
    const told = (measured: number | null) =>
      toldEnd({ progress, axes: { X: { commanded: 1, measured, load: null } } } as unknown as State);
    expect(told(1)).toBe(`completed. NOT PROVEN: ${lacks}; Judged as one with what 7 did`);
    expect(told(null)).toBe(
      "completed. NOT PROVEN: nothing was measured, because this controller reports commanded positions only; Judged as one with what 7 did",
    );
  });
  it("is trouble out of spec, after a fault or without a judge, and not where it is not proven", () => {
    const wrong = (verdict: string, ended = "completed") => inTrouble({ ended, verdict });
    for (const verdict of ["OUT OF SPEC (nominal)", "out of spec", "NOT JUDGED: no disk"])
      expect(wrong(verdict), verdict).toBe(true);
    for (const verdict of ["IN SPEC", "in spec", "NOT PROVEN: x", "not proven", "LIMITS KEPT", "not judged"])
      expect(wrong(verdict), verdict).toBe(false);
    expect(wrong("NOT PROVEN: it did not reach its end", "fault")).toBe(true);
    expect(wrong("NOT PROVEN: it did not reach its end", "stopped")).toBe(false);
  });
});

describe("where a run is", () => {
  it("is told with the turning of a mandrel where it hardly feeds", () => {
    expect(feedOf(0.4, 36)).toEqual([36, "°/s"]);
    expect(feedOf(36, 90)).toEqual([36, "mm/s"]);
    expect(feedOf(0, 0)).toEqual([0, "mm/s"]);
  });
  it("is told in stitches, else in circuits", () => {
    const lines = { times_s: [0, 2], line: [1, 2], circuit: [1, 2] };
    const work = { lines, circuits: 2, stitches: null } as unknown as Figures;
    expect(placeInWords(work, 2.5)).toBe("circuit 2 of 2");
    const stitches = { times_s: [0, 1, 2], number: [0, 1, 2], count: 9 } as unknown as Figures["stitches"];
    expect(placeInWords({ ...work, stitches }, 1.5)).toBe("stitch 1 of 9");
  });
});

describe("amounts and times for people", () => {
  it("tell when a run ends", () => {
    expect(timeOfDay(3600, new Date(2026, 10, 30, 12, 7, 30))).toMatch(/^(1:07 PM|13:07)$/);
  });

  it("have a unit and three digits", () => {
    expect(amount(0.00045, "m")).toBe("0.450 mm");
    expect(amount(0.032, "")).toBe("3.20 %");
    expect(amount(Math.PI, "rad")).toBe("180 °");
    expect(amount(1.29, "stitch")).toBe("1.29 stitches");
  });
  it("count up to the next whole second, so that 0:00 is the end", () => {
    expect(clock(0)).toBe("0:00");
    expect(clock(0.2)).toBe("0:01");
    expect(clock(7)).toBe("0:07");
    expect(clock(3661)).toBe("1:01:01");
  });
});

describe("criteria", () => {
  it("are sentences with their limit and what was measured", () => {
    expect(sentence(criterion({}))).toBe("the tool stays within 0.500 mm of its path: 0.450 mm");
    const stitches = criterion({ name: "stitch_length_error", unit: "", measured: 0.032, limit: 0.05 });
    expect(sentence(stitches)).toBe("stitches at most 5.00 % too short or too long: 3.20 %");
    expect(sentence(criterion({ name: "jerk", axis: "X", unit: "m/s^3", limit: 2, measured: 1 }))).toBe(
      "X changes its acceleration by at most 2.00 m/s³: 1.00 m/s³",
    );
    expect(
      sentence(criterion({ name: "jerk", axis: "A", unit: "rad/s^3", limit: Math.PI, measured: 0 })),
    ).toBe("A changes its acceleration by at most 180 °/s³: 0.000 °/s³");
    expect(sentence(criterion({ name: "weld_gap", axis: "X", unit: "m/s^4", limit: 2, measured: 1 }))).toBe(
      "weld gap of X, at most 2.00 m/s^4: 1.00 m/s^4",
    );
  });
  it("without a limit use no share of one", () => {
    expect(used(criterion({ limit: null }))).toBeNull();
    expect(used(criterion({ limit: 0 }))).toBeNull();
    expect(used(criterion({}))).toBeCloseTo(0.9);
  });
  it("are listed up to eight, with all that failed, and the others are counted", () => {
    const of = (count: number, status: Criterion["status"]) =>
      Array.from({ length: count }, (_, k) => criterion({ name: `one_${status}_${k}`, status }));
    expect(nearest(of(8, "passed")).others).toBe("");
    const found = nearest(of(9, "passed"));
    expect([found.shown.length, found.others]).toEqual([8, "1 other criterion is farther from the limit"]);
    expect(nearest([...of(3, "passed"), ...of(10, "failed")]).shown).toHaveLength(10);
  });

  it("are told once for each axis, the failed ones first", () => {
    const found = worst([
      criterion({ measured: 0.0001 }),
      criterion({}),
      criterion({ name: "velocity", axis: "X", measured: 0.1, limit: 1, status: "failed" }),
      criterion({ name: "jerk", limit: null }),
    ]);
    expect(found.map((one) => [one.name, one.measured])).toEqual([
      ["velocity", 0.1],
      ["contour_error", 0.00045],
    ]);
  });
});

describe("the last time not later than another", () => {
  it("is that of a linear search, for every place", () => {
    const times = [0, 0.5, 0.5, 1.25, 3];
    for (const time of [-1, 0, 0.25, 0.5, 1, 1.25, 2.9, 3, 10]) {
      const slow = times.filter((one) => one <= time).length - 1;
      expect(before(times, time)).toBe(slow);
    }
    expect(before([], 1)).toBe(-1);
  });
});

describe("a verdict", () => {
  const told = "IN SPEC (repeated: 20 runs; 92 % of contour_error used; 1 criterion not measured)";
  it("has no underscores, and says what was simulated", () => {
    expect(verdictWords(told)).toBe(
      "IN SPEC (20 simulated runs; contour error is at 92 % of its limit; 1 criterion not measured)",
    );
  });
  it("of a run of the machine says nothing of simulation", () => {
    expect(verdictOfRun("OUT OF SPEC (nominal: 1 run; 120 % of tracking_error of X used)")).toBe(
      "OUT OF SPEC (tracking error of X is at 120 % of its limit)",
    );
    expect(verdictOfRun("NOT PROVEN (nominal: 1 run): step loss was not measured")).toBe(
      "NOT PROVEN: step loss was not measured",
    );
  });
});
