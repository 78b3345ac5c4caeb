import { describe, expect, it } from "vitest";
import { inSpace } from "../src/wound";

describe("a place on the mandrel", () => {
  it("is under the eye, which is above, once the mandrel has turned by minus its angle", () => {
    for (const angle of [0, 0.7, -2, 5]) {
      const [x, y, z] = inSpace(0.3, 0.05, angle);
      const turn = -angle; // about x, as three.js turns a group
      expect(x).toBe(0.3);
      expect(y * Math.cos(turn) - z * Math.sin(turn)).toBeCloseTo(0, 12);
      expect(y * Math.sin(turn) + z * Math.cos(turn)).toBeCloseTo(0.05, 12);
    }
  });
});
