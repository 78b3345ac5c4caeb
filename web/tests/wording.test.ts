import { describe, expect, it } from "vitest";
import type { Criterion } from "../src/messages";
import { amount, before, clock, sentence, used, worst } from "../src/wording";

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

describe("amounts and times for people", () => {
  it("have a unit and three digits", () => {
    expect(amount(0.00045, "m")).toBe("0.450 mm");
    expect(amount(0.032, "")).toBe("3.20 %");
    expect(amount(Math.PI, "rad")).toBe("180 °");
    expect(amount(1.29, "stitch")).toBe("1.29 stitch");
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
    expect(sentence(criterion({ name: "jerk", axis: "X", unit: "m/s^3", measured: 1, limit: 2 }))).toBe(
      "jerk of X, at most 2.00 m/s^3: 1.00 m/s^3",
    );
  });
  it("without a limit use no share of one", () => {
    expect(used(criterion({ limit: null }))).toBeNull();
    expect(used(criterion({ limit: 0 }))).toBeNull();
    expect(used(criterion({}))).toBeCloseTo(0.9);
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
