import { describe, expect, it } from "vitest";
import { brokenOff, hintOf, howToGoOn, lastRun } from "../src/continuing";
import { deviceName } from "../src/device";
import { facts, nextTurn, reading, whyInWords } from "../src/facts";
import { lineAt, Stretches } from "../src/live_error";
import type { Figures, Progress, State } from "../src/messages";
import { extend } from "../src/steps";

const run = (more: Partial<Progress> = {}): Progress => ({
  run: "1",
  program: "small vessel",
  file: "a.wind.toml",
  time_s: 2,
  duration_s: 10,
  ended: null,
  why: "",
  verdict: "",
  completed: 3,
  hold: "at once",
  hold_at_s: null,
  contour: null,
  ...more,
});
const state = (progress: Progress | null, more: object = {}) =>
  ({
    progress,
    axes: {},
    readings: {},
    feed_percent: 100,
    state: "running",
    rest: null,
    proven: null,
    ...more,
  }) as unknown as State;
const figures = (more: object) =>
  ({ program: "a.wind.toml", steps: [], turn_rounds: null, stitches: null, ...more }) as unknown as Figures;
const sewn = { stitches: { times_s: [1, 4, 7], number: [1, 2, 3], threads: [] } };

describe("the next turn-round", () => {
  const winding = figures({ turn_rounds: { axis: "X", times_s: [1, 5], at: [0.06, 0] } });
  it("is the first one after now, and none after the last", () => {
    expect(nextTurn(winding, 2)).toEqual({ in_s: 3, at: 0 });
    expect(nextTurn(winding, 5)).toBeNull();
    expect(nextTurn(figures({}), 0)).toBeNull();
  });
  it("comes later at a slower feed", () => {
    expect(facts(state(run(), { feed_percent: 50 }), winding)).toEqual([
      "next turn-round in 0:06, at X 0.0 mm",
    ]);
  });
});

describe("the tension of the fibre", () => {
  const tension = { times_s: [0, 2, 4], mean: [0, 7.2, 7.9], least: 0, most: 8.1 };
  const spooled = figures({ tension });
  it("is the simulated one at the place of the run, and says so", () => {
    expect(facts(state(run({ time_s: 3 })), spooled)).toEqual([
      "tension of the fibre 7.20 N in the simulation, which has at most 8.10 N",
    ]);
    expect(facts(state(run({ time_s: 3 })), figures({}))).toEqual([]);
  });
  it("is the machine's own where that reports one", () => {
    const readings = { tension: { value: 6.5, unit: "N" } };
    expect(facts(state(run(), { readings }), spooled)).toEqual(["tension of the fibre 6.50 N"]);
  });
});

describe("where a hold stands", () => {
  it("is at once on a seam, at the end of a stitch of a design", () => {
    expect(facts(state(run()), figures(sewn))).toEqual(["a hold stands at once, on the seam"]);
    const design = { stitches: { ...sewn.stitches, threads: [null] } };
    expect(facts(state(run()), figures(design))).toEqual(["a hold stands at the end of the stitch"]);
  });
  it("is told until a hold that waits for a rest has come to it", () => {
    const why = "it goes on to the next rest and stands there";
    const waits = run({ hold: "at a rest", hold_at_s: 4.5 });
    const goesOn = state(waits, { state: "holding", why });
    expect(whyInWords(goesOn)).toBe(why);
    expect(facts(goesOn, figures(sewn))).toEqual(["it stands at the next rest, after stitch 2: in 2.5 s"]);
    const stands = state({ ...waits, time_s: 4.5 }, { state: "holding", why });
    expect(whyInWords(stands)).toBe("it stands at a rest of the program");
    expect(facts(stands, figures(sewn))).toEqual([]);
    expect(whyInWords(state(null, { state: "fault", why: "the link is gone" }))).toBe("the link is gone");
  });
  it("stands where its run has not gone on for a while, wherever the next rest is", () => {
    const why = "it goes on to the next rest and stands there";
    const held = (time_s: number) =>
      state(run({ run: "held", time_s, hold: "at a rest", hold_at_s: 6 }), { state: "holding", why });
    expect(whyInWords(held(4.1), 1000)).toBe(why);
    expect(whyInWords(held(4.2), 1300)).toBe(why);
    expect(whyInWords(held(4.2), 1600)).toBe(why);
    expect(whyInWords(held(4.2), 1700)).toBe("it stands at a rest of the program");
    expect(whyInWords(held(4.3), 1800)).toBe(why);
  });
  it("is at a rest where it leaves the path elsewhere, told with its stitch", () => {
    const waits = run({ hold: "at a rest", hold_at_s: 4.5 });
    expect(facts(state(waits), figures(sewn))).toEqual([
      "a hold stands at the next rest, after stitch 2: in 2.5 s",
    ]);
    expect(facts(state(run({ hold: "at the end" })), figures(sewn))).toEqual([
      "a hold would stand only at the end of the program",
    ]);
  });
  it("is not told in a hold, nor at rest", () => {
    expect(facts(state(run(), { state: "holding" }), figures(sewn))).toEqual([]);
    expect(facts(state(run({ ended: "completed" })), figures(sewn))).toEqual([]);
  });
});

describe("what is there is told, and nothing else", () => {
  it("counts the cycles of a cycle", () => {
    const cycle = figures({ steps: [{ name: "pick", line: 1, begin_s: 0 }] });
    expect(facts(state(run({ ended: "completed" })), cycle)).toEqual([
      "cycles completed since the machine was connected: 3",
    ]);
  });
  it("has readings in words, with their units", () => {
    expect(reading("tension", 12.5, "N")).toBe("tension of the fibre 12.5 N");
    expect(reading("spool_speed", 1.25, "rad/s")).toBe("spool speed 71.6 °/s");
    expect(facts(state(null, { readings: { tension: { value: 8, unit: "N" } } }), null)).toEqual([
      "tension of the fibre 8.00 N",
    ]);
  });
});

describe("the last run", () => {
  it("has its end, and its verdict as soon as it is there", () => {
    expect(lastRun(state(run()))).toBeNull();
    expect(lastRun(state(run({ ended: "completed" })))!.text).toContain("Its verdict is being worked out.");
    const judged = lastRun(state(run({ ended: "completed", verdict: "IN SPEC (nominal)" })));
    expect(judged).toEqual({ text: "small vessel: completed. IN SPEC (nominal)", wrong: false });
    expect(lastRun(state(run({ ended: "completed", verdict: "OUT OF SPEC" })))!.wrong).toBe(true);
    expect(lastRun(state(run({ ended: "stopped", verdict: "NOT PROVEN" })))!.wrong).toBe(false);
    expect(lastRun(state(run({ ended: "fault" })))!.wrong).toBe(true);
  });
});

describe("a run that was broken off", () => {
  const stopped = (more: object = {}) =>
    state(run({ ended: "stopped" }), { proven: { program: "a.wind.toml" }, state: "idle", ...more });
  const known = { stitches: true, byHand: false, atStart: true };
  it("can be gone on with while its program is the calculated one", () => {
    expect(brokenOff(stopped())).toBe(true);
    expect(brokenOff(stopped({ proven: { program: "small vessel" } }))).toBe(false);
    expect(brokenOff(stopped({ proven: { program: "a.prg" } }))).toBe(false);
    expect(brokenOff(state(run({ ended: "completed" }), { proven: { program: "a.wind.toml" } }))).toBe(false);
    expect(brokenOff(state(null))).toBe(false);
  });
  it("leads by sentences: idle, home, back", () => {
    expect(howToGoOn(stopped({ state: "fault" }), known)).toContain("bring the machine to idle");
    expect(howToGoOn(stopped(), { ...known, atStart: false })).toContain("home the machine first");
    expect(howToGoOn(stopped(), known)).toContain("After a thread break, go some stitches back.");
    expect(howToGoOn(stopped({ rest: { run: "1", notes: ["line 4"] } }), known)).toContain(
      "line 4. Start the rest confirms",
    );
  });
});

describe("the error along a program", () => {
  it("keeps the largest value of each stretch", () => {
    const found = new Stretches(10, 5);
    found.add(0, 1, 3);
    found.add(1, 4.5, 2);
    found.add(10, 10, 7);
    expect([...found.largest]).toEqual([3, 2, 2, -1, 7]);
  });
  it("leads to the line that is under way", () => {
    const lines = figures({ lines: { times_s: [0, 3], line: [4, 9], circuit: [0, 0] } });
    expect([lineAt(lines, 2.9), lineAt(lines, 3), lineAt(lines, -1), lineAt(null, 1)]).toEqual([4, 9, 0, 0]);
  });
});

describe("an actual lane", () => {
  it("has a span from each switching on to the switching off", () => {
    const spans: [number, number][] = [];
    for (const [time, on] of [
      [0, false],
      [1, true],
      [2, true],
      [3, false],
      [4, true],
    ] as [number, boolean][])
      extend(spans, time, on);
    expect(spans).toEqual([
      [1, 3],
      [4, Number.POSITIVE_INFINITY],
    ]);
  });
});

describe("the name of a browser", () => {
  it("is what its owner calls it", () => {
    const chrome = "Mozilla/5.0 (X11; Linux x86_64) AppleWebKit/537.36 Chrome/142.0.0.0 Safari/537.36";
    expect(deviceName(chrome)).toBe("Chrome on Linux");
    const phone = "Mozilla/5.0 (iPhone; CPU iPhone OS 18_0 like Mac OS X) Version/18.0 Mobile Safari/604.1";
    expect(deviceName(phone)).toBe("Safari on iPhone");
    const edge = "Mozilla/5.0 (Windows NT 10.0; Win64; x64) Chrome/142.0.0.0 Safari/537.36 Edg/142.0.0.0";
    expect(deviceName(edge)).toBe("Edge on Windows");
    expect(deviceName("curl")).toBe("a browser");
  });
});

describe("how a rest is prepared", () => {
  it("names only the places that the work has", () => {
    const placer = hintOf({ cylinders: [1], embroiders: false });
    expect(placer).toContain("(line 40)");
    expect(placer).not.toMatch(/circuit|stitch/);
    expect(hintOf({ cylinders: [], embroiders: true })).not.toMatch(/circuit/);
    expect(hintOf({ cylinders: [], embroiders: false })).toMatch(/circuit 12.*stitch 120/);
  });
});
