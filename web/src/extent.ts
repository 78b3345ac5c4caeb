/** What a program has and how far it goes, before it is calculated. */

import type { Preview } from "./messages";
import { counted } from "./wording";

type Content = Pick<Preview, "planned" | "moves" | "stitches" | "steps">;

/** Smallest and largest of some numbers; no arguments of a call, since there may be many. */
function range(values: number[]): [number, number] {
  return values.reduce(([low, high], one) => [Math.min(low, one), Math.max(high, one)], [
    Number.POSITIVE_INFINITY,
    Number.NEGATIVE_INFINITY,
  ] as [number, number]);
}

/** The size of a work and the way of each axis: "185 stitches, 62.0 x 48.5 mm", "4 points; X 0.0 to 60.0 mm". */
export function extentInWords(found: Content, unitOf: (name: string) => [number, string]): string {
  const { stitches } = found;
  if (stitches?.x.length) {
    const [wide, tall] = [stitches.x, stitches.y].map((places) => {
      const [low, high] = range(places);
      return (1000 * (high - low)).toFixed(1);
    });
    const threads = stitches.threads.length > 1 ? `, ${counted(stitches.threads.length, "thread")}` : "";
    return `${counted(stitches.count, "stitch", "stitches")}, ${wide} x ${tall} mm${threads}`;
  }
  const ways = Object.entries(found.planned)
    .filter(([, places]) => places.length > 0)
    .map(([name, places]) => {
      const [scale, unit] = unitOf(name);
      const [low, high] = range(places).map((at) => (scale * at).toFixed(1));
      return `${name} ${low} to ${high} ${unit}`;
    });
  const has = found.steps.length ? counted(found.steps.length, "step") : counted(found.moves, "move");
  return ways.length ? `${has}; ${ways.join(", ")}` : has;
}
