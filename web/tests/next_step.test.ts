import { describe, expect, it } from "vitest";
import type { State } from "../src/messages";
import { type Known, nextStep } from "../src/next_step";

const KNOWN: Known = { mine: true, chosen: true, changed: false, wantsReason: false, atStart: true };
const PROVEN = { program: "a.prg", proof: "0", passed: true, closing: "IN SPEC" };
const state = (name: string, allowed: string[], more: Partial<State> = {}): State =>
  ({
    state: name,
    allowed,
    busy: "",
    calculating: null,
    proven: null,
    control: { client: 1, name: "", left_s: 5, asks: null, asks_name: "", passes_in_s: 0 },
    ...more,
  }) as State;
const step = (found: State, known: Partial<Known> = {}) =>
  nextStep(found, { ...KNOWN, ...known })?.what ?? "";

describe("the next step", () => {
  it("leads from the first look to the start of a program", () => {
    const free = { client: null, name: "", left_s: 0, asks: null, asks_name: "", passes_in_s: 0 };
    expect(step(state("disabled", [], { control: free }), { mine: false })).toBe("take");
    expect(step(state("disabled", ["enable"]))).toBe("enable");
    expect(step(state("enabled", ["home"]))).toBe("home");
    expect(step(state("idle", ["calculate"]), { chosen: false })).toBe("load");
    expect(step(state("idle", ["calculate"]))).toBe("calculate");
    const ready = state("idle", ["start", "approach"], { proven: PROVEN });
    expect(step(ready, { atStart: false })).toBe("approach");
    expect(step(ready)).toBe("start");
  });
  it("is to home where nothing else leads to the beginning of a program", () => {
    const stopped = state("idle", ["start", "home"], { proven: PROVEN }); // an embroidery frame
    expect(step(stopped, { atStart: false })).toBe("home");
    expect(step(stopped)).toBe("start");
  });
  it("is to calculate again after a change, and to give a reason out of specification", () => {
    const ready = state("idle", ["start"], { proven: PROVEN });
    expect(step(ready, { changed: true })).toBe("calculate");
    expect(step(ready, { wantsReason: true })).toBe("reason");
  });
  it("is to resume in a hold, and to reset or reconnect after a fault", () => {
    expect(step(state("holding", ["resume"]))).toBe("resume");
    expect(step(state("fault", ["reset", "reconnect"]))).toBe("reset");
    expect(step(state("gone", ["reconnect"]))).toBe("reconnect");
  });
  it("is none where the operator waits, or somebody else has control", () => {
    expect(step(state("running", ["hold"]))).toBe("");
    const judged = state("idle", [], { busy: "the last run is being judged" });
    expect(nextStep(judged, KNOWN)).toEqual({
      what: "",
      text: "wait, the last run is being judged",
      part: "",
    });
    expect(step(state("idle", ["start"]), { mine: false })).toBe("");
  });
});
