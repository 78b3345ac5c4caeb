/** The error of the run at each moment against its limit, and the worst place of the calculation. */

import { by, made, put } from "./dom";
import type { Criterion, Figures, State } from "./messages";
import { hasLines, row } from "./verdict";
import { used } from "./wording";

/** The criteria that say where the tool, the fibre, or a stitch is; the first that a job has is shown. */
const PLACED = [
  "contour_error",
  "laid_error",
  "stitch_length_error",
  "seam_error",
  "stitch_residual",
  "residual_vibration",
  "tracking_error",
];
const MOST = 2;

/** The results of a calculation that an operator watches, the most used limit first. */
export function watched(criteria: Criterion[]): Criterion[] {
  const own = criteria.filter((one) => PLACED.includes(one.name) && used(one) !== null);
  const first = new Map<string, Criterion>();
  for (const one of own) {
    const known = first.get(one.name);
    if (!known || used(one)! > used(known)!) first.set(one.name, one);
  }
  return [...first.values()].sort((a, b) => used(b)! - used(a)!).slice(0, MOST);
}

export class Margins {
  private worst: Criterion[] = [];

  constructor(private readonly toLine: (line: number) => void) {}

  show(figures: Figures | null): void {
    this.worst = figures ? watched(figures.criteria) : [];
    put(by("margin"), "hidden", this.worst.length === 0);
    const list = made("ul");
    list.append(...this.worst.map((one) => row(one, hasLines(figures!) ? this.toLine : null)));
    by("margin-rows").replaceChildren(list);
  }

  /** Mark the worst place while the run is near it. */
  live(state: State): void {
    const run = state.progress;
    const near = !!run && run.ended === null && this.worst.some((one) => nearBy(one, run.time_s));
    put(by("margin"), "className", near ? "near" : "");
  }
}

const NEAR_S = 1;

function nearBy(one: Criterion, time_s: number): boolean {
  return one.time_s !== null && Math.abs(one.time_s - time_s) < NEAR_S;
}
