import { describe, expect, it } from "vitest";
import { filled, inOrder, settingsInWords, shortly, Typed } from "../src/board";
import type { BoardSetting } from "../src/messages";

const of = (number: number, mark: BoardSetting["mark"], file = "1"): BoardSetting => ({
  number,
  name: "",
  unit: "",
  board: "1",
  words: "",
  file,
  mark,
});

describe("the settings of a board", () => {
  const settings = [of(0, "", ""), of(100, "same"), of(110, "lower"), of(120, "refused"), of(103, "refused")];
  it("have what must be corrected first, and what the machine file does not have last", () => {
    expect(inOrder(settings).map((one) => one.number)).toEqual([103, 120, 110, 100, 0]);
  });
  it("are counted in a sentence", () => {
    expect(settingsInWords(settings)).toBe(
      "Compared with the machine file: 2 must be corrected, 1 lower than the file, which is allowed, 1 the same.",
    );
    expect(settingsInWords([of(0, "", "")])).toBe("");
  });
  it("lose the noughts at their ends, and no others", () => {
    expect(["4800.000", "0.020", "100", "not told", "10.5"].map(shortly)).toEqual([
      "4800",
      "0.02",
      "100",
      "not told",
      "10.5",
    ]);
  });
});

describe("the fill of a buffer", () => {
  it("is told with its share", () => {
    const found = filled({ blocks: 3, of_blocks: 15, characters: 96, of_characters: 128 });
    expect(found).toEqual([
      ["planner: 3 of 15 blocks", 0.2],
      ["receive buffer: 96 of 128 characters", 0.75],
    ]);
  });
});

describe("typed lines", () => {
  it("are gone through by arrows, back to the empty line", () => {
    const typed = new Typed();
    expect(typed.go(-1)).toBe("");
    for (const line of ["$$", "$G", "$G"]) typed.add(line);
    expect([typed.go(-1), typed.go(-1), typed.go(-1)]).toEqual(["$G", "$$", "$$"]);
    expect([typed.go(1), typed.go(1), typed.go(1)]).toEqual(["$G", "", ""]);
  });
});
