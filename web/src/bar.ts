/** The bar that is always in sight: state, program, line under way, time left, feed, next step. */

import { pace } from "./cloth";
import { by, made, put, tell, value } from "./dom";
import { whyInWords } from "./facts";
import type { Figures, State } from "./messages";
import type { Step } from "./next_step";
import type { Session } from "./session";
import { unitOf } from "./session";
import { before, clock, isOf } from "./wording";

const LOOKS: Record<string, string> = {
  homing: "moves",
  jogging: "moves",
  running: "moves",
  stopping: "moves",
  holding: "held",
  fault: "wrong",
  gone: "wrong",
};
/** What a state means, for a reader who waits; used if the machine gives no reason. */
const PREPARES: Record<string, string> = {
  connecting: "the machine is being prepared; the first time on a computer this takes up to a minute",
};
/** Text for a page without a connection. */
const ALONE = "trying again; a run goes on, unless the panel has ended: then the machine stops";
const FEED_MS = 250;
export const STEP_PERCENT = 10;

/** Progress of a run in the operator's units: "circuit 2 of 3", "stitch 12 of 185"; empty without a count. */
export function placeInWords(
  figures: Pick<Figures, "lines" | "circuits" | "stitches">,
  time_s: number,
): string {
  const { stitches, lines, circuits } = figures;
  if (stitches)
    return `stitch ${stitches.number[before(stitches.times_s, time_s)] ?? 0} of ${stitches.count}`;
  const circuit = lines.circuit[before(lines.times_s, time_s)] ?? 0;
  return circuit && circuits ? `circuit ${circuit} of ${circuits}` : "";
}

/** The speed that is shown of linear axes, mm/s, and of turning ones, °/s: a mandrel may turn with hardly a feed. */
export function feedOf(linear: number, turning: number): [number, string] {
  return linear < 0.5 && turning >= 0.5 ? [turning, "°/s"] : [linear, "mm/s"];
}

/** Stitches a minute at an instant of the plan; null for other work. */
function stitchesAMinute(figures: Figures, time_s: number, percent: number): number | null {
  const { stitches } = figures;
  return stitches && pace(stitches, before(stitches.times_s, time_s), percent);
}

export class Bar {
  private chip = "";
  private feedMs = 0;
  private was: State | null = null; // the state from which the feed is measured

  constructor(private readonly session: Session) {
    by("slower").onclick = () => session.overrideFeed(-STEP_PERCENT);
    by("faster").onclick = () => session.overrideFeed(STEP_PERCENT);
  }

  /** Show the state as a chip, with its reason beside it. */
  tellState(state: State | null, refused: string): void {
    const word = state?.state ?? (refused ? "refused by the panel" : "no connection");
    const why = state ? whyInWords(state) || PREPARES[state.state] || "" : refused || ALONE;
    const told = `${word}\n${why}`;
    put(by("state").dataset, "look", state ? (LOOKS[state.state] ?? "") : "wrong");
    if (told === this.chip) return;
    this.chip = told;
    by("state").title = why;
    const colon = made("span", ": "); // read aloud only: the reason stands under the chip
    colon.className = "unseen";
    by("state").replaceChildren(made("b", word), ...(why ? [colon, why] : []));
  }

  /** Show the program and its line, and the time left; return the line under way, 0 for none. */
  tellRun(state: State, figures: Figures | null): number {
    const run = state.progress;
    const runs = !!run && run.ended === null;
    const program = runs ? run.program : (state.proven?.program ?? value("program"));
    tell("now-program", program || "no program yet");
    const own = figures && (!runs || isOf(figures.program, run));
    const at = runs && own ? before(figures.lines.times_s, run.time_s) : -1;
    const line = at < 0 ? 0 : figures!.lines.line[at]!;
    put(by("now-line"), "hidden", !runs || line === 0 || this.session.embroiders); // a design has no lines
    if (line) tell("now-line", `line ${line}`);
    tell("now-circuit", runs && own ? placeInWords(figures, run.time_s) : "");
    const slower = 100 / state.feed_percent;
    const left = runs
      ? (run.duration_s - run.time_s) * slower
      : state.proven && figures
        ? figures.duration_s
        : null;
    tell("time-left", left === null ? "–" : clock(left));
    const whole = state.feed_percent === 100 ? `left of ${clock(run?.duration_s ?? 0)}` : "time left";
    tell("left-told", runs ? whole : program && left === null ? "not calculated" : "duration");
    const sewn = runs && own ? stitchesAMinute(figures, run.time_s, state.feed_percent) : null;
    this.tellFeed(state, sewn);
    this.tellOverride(state, runs);
    return line;
  }

  /** Show an override of the feed, if there is one, and its steps, if the machine takes any. */
  private tellOverride(state: State, runs: boolean): void {
    const { session } = this;
    put(by("feed-row"), "hidden", session.axes.length === 0); // cylinders have no feed
    for (const id of ["slower", "faster"]) put(by(id), "hidden", !session.feedOverride);
    tell("feed-percent", runs && state.feed_percent !== 100 ? `at ${state.feed_percent} %` : "");
  }

  /** Stitches a minute; else the speed of the command over all linear axes, or of the fastest other one. */
  private tellFeed(state: State, sewn: number | null): void {
    const now = performance.now();
    if (this.was && now - this.feedMs < FEED_MS) return;
    const was = this.was;
    [this.was, this.feedMs] = [state, now];
    const moves = this.session.machineMoves() && state.state !== "holding";
    const dt = was ? state.time_s - was.time_s : 0;
    let [linear, turning] = [0, 0];
    if (moves && was && dt > 0)
      for (const [name, at] of Object.entries(state.axes)) {
        const from = was.axes[name]?.commanded ?? null;
        if (from === null || at.commanded === null) continue;
        const speed = ((at.commanded - from) * unitOf(this.session, name)[0]) / dt;
        if (unitOf(this.session, name)[1] === "mm") linear = Math.hypot(linear, speed);
        else turning = Math.max(turning, Math.abs(speed));
      }
    else if (moves && dt === 0) return;
    const [feed, unit] = sewn === null ? feedOf(linear, turning) : [sewn, "stitches/min"];
    tell("feed-now", moves ? feed.toFixed(0) : "–");
    tell("feed-unit", unit);
  }

  /** Mark the button to press next, and name it. */
  tellNext(step: Step | null): void {
    tell("next", step ? `Next: ${step.text}` : "");
    put(by("next"), "hidden", step === null);
    const marked = step?.what ?? "";
    for (const one of document.querySelectorAll<HTMLButtonElement>("button[data-what], #take"))
      one.classList.toggle("next", marked !== "" && (one.dataset.what ?? one.id) === marked);
    const part = document.body.dataset.part;
    for (const tab of document.querySelectorAll<HTMLButtonElement>("nav button"))
      tab.classList.toggle("next", !!step?.part && tab.dataset.part === step.part && step.part !== part);
  }

  /** Distance from the command to the end of the line under way, SI, of each axis. */
  toGo(state: State, figures: Figures | null): Record<string, number> {
    const run = state.progress;
    if (!figures || !run || run.ended !== null) return {};
    const { times_s } = figures.lines;
    const end = times_s[before(times_s, run.time_s) + 1] ?? figures.duration_s;
    const k = Math.max(before(figures.times_s, end), 0);
    const found: Record<string, number> = {};
    for (const [name, places] of Object.entries(figures.planned)) {
      const at = state.axes[name]?.commanded;
      if (at !== null && at !== undefined && places[k] !== undefined) found[name] = places[k] - at;
    }
    return found;
  }
}
