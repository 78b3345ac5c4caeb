/** Facts beside the picture, in short sentences, for the operator of each kind of machine. */

import { by, made, put } from "./dom";
import type { Figures, State } from "./messages";
import { amount, before, clock, isOf } from "./wording";

const NAMES: Record<string, string> = { tension: "tension of the fibre" };

/** A reading with the name of its quantity: "tension of the fibre 12.5 N". */
export function reading(name: string, value: number, unit: string): string {
  const known = NAMES[name] ?? name.replaceAll("_", " ");
  return `${known} ${amount(value, unit)}`;
}

/** When and where the carriage turns round next, after an instant of the plan; null for never. */
export function nextTurn(figures: Figures, time_s: number): { in_s: number; at: number } | null {
  const turns = figures.turn_rounds;
  if (!turns) return null;
  const k = before(turns.times_s, time_s) + 1;
  return k < turns.times_s.length ? { in_s: turns.times_s[k]! - time_s, at: turns.at[k]! } : null;
}

const AT_REST_S = 0.02;

const STILL_MS = 400; // a held run without progress for this long stands still
let still: { key: string; sinceMs: number } = { key: "", sinceMs: 0 };

/** Whether the states of a held run show no progress for a while. */
export function standsStill(state: State, nowMs: number): boolean {
  const run = state.progress;
  const key = state.state === "holding" && run ? `${run.run} ${run.time_s}` : "";
  if (key !== still.key) still = { key, sinceMs: nowMs };
  return key !== "" && nowMs - still.sinceMs >= STILL_MS;
}

/** Why the machine is in its state; a hold that waits for a rest says when it has come to one. */
export function whyInWords(state: State, nowMs = performance.now()): string {
  const run = state.progress;
  const stands = standsStill(state, nowMs);
  const waited = state.state === "holding" && run?.ended === null && run.hold !== "at once";
  if (!waited) return state.why;
  const there = run.hold_at_s !== null && run.hold_at_s - run.time_s < AT_REST_S;
  return there || stands ? "it stands at a rest of the program" : state.why;
}

/** Where a hold takes effect: the present one, or one that is requested now. */
export function holdInWords(state: State, figures: Figures | null): string {
  const run = state.progress!;
  const { stitches } = figures ?? {};
  const stitch = (time_s: number) => stitches!.number[before(stitches!.times_s, time_s)] ?? 0;
  if (run.hold === "at the end") return "a hold would stand only at the end of the program";
  if (run.hold === "at a rest") {
    const at = run.hold_at_s!;
    const left = ((at - run.time_s) * 100) / state.feed_percent;
    const after = stitches?.times_s.length && stitch(at) ? `, after stitch ${stitch(at)}` : "";
    const what = state.state === "holding" ? "it stands" : "a hold stands";
    return `${what} at the next rest${after}: in ${Math.max(left, 0).toFixed(1)} s`;
  }
  if (stitches?.threads.length) return "a hold stands at the end of the stitch";
  return stitches ? "a hold stands at once, on the seam" : "";
}

/** The tension of the fibre in the simulated run at an instant of the plan; nothing without a spool. */
export function tensionInWords(figures: Figures, time_s: number): string {
  const { tension } = figures;
  if (!tension) return "";
  const now = tension.mean[Math.max(before(tension.times_s, time_s), 0)]!;
  return `${reading("tension", now, "N")} in the simulation, which has at most ${amount(tension.most, "N")}`;
}

/** The facts of a state, one to a line. */
export function facts(state: State, figures: Figures | null): string[] {
  const run = state.progress;
  const own = run && figures && isOf(figures.program, run) ? figures : null;
  const found: string[] = [];
  if (run && run.ended === null) {
    const turn = own && nextTurn(own, run.time_s);
    if (turn)
      found.push(
        `next turn-round in ${clock((turn.in_s * 100) / state.feed_percent)}, at ${own!.turn_rounds!.axis} ${(1000 * turn.at).toFixed(1)} mm`,
      );
    const tension = own && !state.readings.tension ? tensionInWords(own, run.time_s) : "";
    if (tension) found.push(tension);
    const goesOn = state.state === "holding" && run.hold === "at a rest" && whyInWords(state) === state.why;
    const hold = state.state === "running" || goesOn ? holdInWords(state, own) : "";
    if (hold) found.push(hold);
  }
  if (own?.steps.length) found.push(`cycles completed since the machine was connected: ${run!.completed}`);
  for (const [name, one] of Object.entries(state.readings)) found.push(reading(name, one.value, one.unit));
  return found;
}

let told = "";

/** Show the facts below the title of the view. */
export function tellFacts(state: State, figures: Figures | null): void {
  const found = facts(state, figures);
  const text = found.join("\n");
  if (text === told) return;
  told = text;
  const list = by("facts");
  const rows = [...list.children];
  found.forEach((one, k) => {
    const row = rows[k] ?? list.appendChild(made("li"));
    put(row, "textContent", one);
  });
  for (const row of rows.slice(found.length)) row.remove();
  put(list, "hidden", found.length === 0);
}
