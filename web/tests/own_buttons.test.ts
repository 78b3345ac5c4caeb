import { describe, expect, it } from "vitest";
import type { State } from "../src/messages";
import { kept, type OwnStep, Runner, stepsOf } from "../src/own_buttons";

const HAS = { console: true, feedOverride: true, normalFeed: true };
const steps = (text: string, has = HAS) => stepsOf(text, has) as OwnStep[];
const state = (seq: number, more: object = {}) =>
  ({
    seq,
    state: "idle",
    allowed: ["home", "calculate", "console"],
    calculating: null,
    proven: null,
    busy: "",
    ...more,
  }) as unknown as State;

describe("the steps of an own button", () => {
  it("are commands, programs with a choice of speed, feeds and lines", () => {
    expect(steps("home\n\n program my strap.prg careful\nprogram a.prg\nfeed 50 %\nline $$")).toEqual([
      { what: "home", text: "home" },
      {
        what: "calculate",
        text: "program my strap.prg careful",
        program: "my strap.prg",
        priority: "accuracy",
      },
      { what: "calculate", text: "program a.prg", program: "a.prg", priority: "programmed" },
      { what: "override-feed", text: "feed 50 %", percent: 50 },
      { what: "console", text: "line $$", line: "$$" },
    ]);
  });
  it("start nothing and move nothing by hand", () => {
    for (const word of ["start", "approach", "jog X", "zero", "step X 1", "continue"])
      expect(stepsOf(`home\n${word}`, HAS)).toMatch(/^step 2, ".*": \w+ is not a step/);
  });
  it("are refused with their line where the machine has no such thing", () => {
    const bare = { console: false, feedOverride: false, normalFeed: false };
    expect(stepsOf("line $$", bare)).toContain("takes no typed lines");
    expect(stepsOf("feed 50 %", bare)).toContain("no feed that can be overridden");
    expect(stepsOf("program a.prg careful", bare)).toContain("normal feed");
    expect(stepsOf("feed 120 %", HAS)).toContain("10 to 100 %");
    expect(stepsOf("dance", HAS)).toContain("it is none of");
    expect(stepsOf(" \n", HAS)).toContain("needs a step");
    expect(stepsOf("home\n".repeat(21), HAS)).toContain("21 steps");
  });
});

describe("a pressed button", () => {
  const started = (text: string) => {
    const [sent, ends]: [string[], string[]] = [[], []];
    const runner = new Runner(
      (step) => (step.program === "none.prg" ? 0 : sent.push(step.text)),
      (why) => ends.push(why),
    );
    runner.begin(steps(text));
    return { runner, sent, ends };
  };
  it("takes each step after the one before is done", () => {
    const { runner, sent, ends } = started("home\nprogram a.prg\nline $$");
    runner.look(state(1), true);
    runner.look(state(2), true);
    expect(sent).toEqual(["home"]); // not answered
    runner.answered(1, true, 3);
    runner.look(state(4), true); // too early to show what it began
    runner.look(state(7, { state: "homing", allowed: [] }), true);
    expect(sent).toEqual(["home"]);
    runner.look(state(8), true);
    runner.answered(2, true, 8);
    runner.look(state(12, { calculating: 0.5 }), true);
    expect(sent).toHaveLength(2);
    runner.look(state(13, { proven: { program: "a.prg" } }), true);
    runner.answered(3, true, 13);
    runner.look(state(14), true);
    expect([sent, ends, runner.busy]).toEqual([["home", "program a.prg", "line $$"], [], false]);
  });
  it("ends at what is refused, at a fault, without control, and where a calculation found nothing", () => {
    const refused = started("home\nline $$");
    refused.runner.look(state(1), true);
    refused.runner.answered(1, false, 1);
    refused.runner.look(state(9), true);
    expect([refused.sent, refused.runner.busy]).toEqual([["home"], false]);
    expect(refused.ends[0]).toContain('"home": it was refused');
    for (const [seen, mine] of [
      [{ state: "fault" }, true],
      [{ state: "stopping" }, true],
      [{ state: "running", allowed: ["hold"] }, true],
      [{}, false],
    ] as [object, boolean][]) {
      const one = started("home");
      one.runner.look(state(1, seen), mine);
      expect([one.sent, one.ends.length, one.runner.busy]).toEqual([[], 1, false]);
    }
    const empty = started("program a.prg\nhome");
    empty.runner.look(state(1), true);
    empty.runner.answered(1, true, 1);
    empty.runner.look(state(9), true);
    expect([empty.sent, empty.ends.length]).toEqual([["program a.prg"], 1]);
    const none = started("program none.prg");
    none.runner.look(state(1), true);
    expect(none.ends[0]).toContain("no such program");
  });
  it("waits while a run is judged, and resets a fault", () => {
    const waits = started("home");
    waits.runner.look(state(1, { allowed: [], busy: "a run is judged" }), true);
    waits.runner.look(state(2), true);
    expect(waits.sent).toEqual(["home"]);
    const resets = started("reset");
    resets.runner.look(state(1, { state: "fault", allowed: ["reset"] }), true);
    expect(resets.sent).toEqual(["reset"]);
  });
});

describe("buttons that a browser has kept", () => {
  it("are read, and nothing else is", () => {
    expect(kept('[{"name": "a", "text": "home"}, {"name": 3}, null]')).toEqual([{ name: "a", text: "home" }]);
    expect([kept(null), kept("{}"), kept("[")]).toEqual([[], [], []]);
  });
});
