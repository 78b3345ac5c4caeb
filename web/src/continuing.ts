/** The rest of an interrupted run: choose a stored run, approach its place, confirm. */

import { button, by, made, put, tell } from "./dom";
import type { State } from "./messages";
import type { Program } from "./program";
import type { Session } from "./session";
import { toldRun } from "./session";
import type { Kept } from "./traces";
import { inTrouble, isOf } from "./wording";

/** How the rest of a run is prepared, with the places that the machine's work has. */
export function hintOf(known: { cylinders: unknown[]; embroiders: boolean }): string {
  const places = known.cylinders.length
    ? "or from a line (line 40)"
    : known.embroiders
      ? "or from a stitch (stitch 120)"
      : "or from a circuit (circuit 12), a line (line 40) or a stitch (stitch 120)";
  return `To continue an interrupted run: load its program, calculate it with the same options, home the machine, then choose the run. It goes on from the block that was under way, ${places}.`;
}
/** Ends after which a run has no rest; see ``store/unfinished.py``. */
const WHOLE = new Set(["completed", "refused"]);

/** Ends after which the page of the machine offers to go on. */
const BROKEN = new Set(["stopped", "fault"]);

/** Whether the last run can be continued: it was broken off, and its program is still the calculated one. */
export function brokenOff(state: State): boolean {
  const run = state.progress;
  return !!run && BROKEN.has(run.ended ?? "") && isOf(state.proven?.program ?? "", run);
}

/** How the last run ended, and its verdict, for the part of the page where the machine is operated. */
export function lastRun(state: State): { text: string; wrong: boolean } | null {
  const run = state.progress;
  if (!run || run.ended === null) return null;
  const judged = run.verdict !== "";
  const text = judged ? toldRun(state) : `${toldRun(state)} Its verdict is being worked out.`;
  return { text, wrong: inTrouble(run) };
}

/** The next step to continue a broken-off run, in a sentence. */
export function howToGoOn(
  state: State,
  known: { stitches: boolean; byHand: boolean; atStart: boolean },
): string {
  const run = state.progress!;
  if (state.rest) return [...state.rest.notes, "Start the rest confirms; STOP discards it"].join(". ");
  const begun = `${run.program} was broken off at ${run.time_s.toFixed(1)} s of ${run.duration_s.toFixed(1)} s`;
  if (state.state !== "idle") return `${begun}. To go on, bring the machine to idle: reset, enable, home.`;
  if (!known.byHand && !known.atStart)
    return `${begun}. To go on, home the machine first: it gets to its place by the program itself, with needle and tools off.`;
  const back = known.stitches ? " After a thread break, go some stitches back." : "";
  return `${begun}. Go on prepares the rest; nothing moves yet.${back}`;
}

/** The rest of the run that was just broken off, where the machine is operated. */
export class RestHere {
  private readonly back = made("input");

  constructor(
    private readonly session: Session,
    private readonly program: Program,
  ) {
    this.back.type = "number";
    this.back.min = "1";
    this.back.max = "999";
    this.back.value = "10";
    const label = made("label", "");
    label.id = "back-stitches";
    label.append(this.back, " stitches");
    const go = (text: string, at: () => string) => {
      const found = button(text, "continue", () => this.go(at()));
      found.dataset.here = "yes";
      return found;
    };
    const from = go("Back", () => `back ${Math.max(Math.round(Number(this.back.value)) || 1, 1)}`);
    from.id = "back";
    const there = button("Go there", "approach-rest", () => session.hold({ what: "approach-rest" }));
    there.id = "go-there";
    by("rest-here-row").replaceChildren(
      go("Go on", () => "block"),
      from,
      label,
      there,
      button("Start the rest", "start-rest", () => session.link.act({ what: "start-rest" })),
    );
  }

  private go(at: string): void {
    const { proven, progress } = this.session.state!;
    if (proven && progress)
      this.session.link.act({
        what: "continue",
        run: progress.run,
        at,
        proof: proven.proof,
        override: this.program.reason(proven),
      });
  }

  show(state: State, stitches: boolean, atStart: boolean): void {
    const last = lastRun(state);
    const offered = brokenOff(state);
    put(by("rest-here"), "hidden", last === null);
    for (const id of ["rest-here-told", "rest-here-row"]) put(by(id), "hidden", !offered);
    if (!last) return;
    tell("last-run-told", last.text);
    put(by("last-run-told"), "className", last.wrong ? "verdict wrong" : "verdict");
    if (!offered) return;
    const { byHand } = this.session;
    for (const id of ["back", "back-stitches"]) put(by(id), "hidden", !stitches);
    put(by("go-there"), "hidden", !byHand);
    tell("rest-here-told", howToGoOn(state, { stitches, byHand, atStart }));
  }
}

export class Continuing {
  private shown = "";

  constructor(
    private readonly session: Session,
    program: Program,
    chosen: () => Kept | null,
  ) {
    const at = made("input");
    at.value = "block";
    at.size = 10;
    at.id = "rest-at";
    const where = made("label", "from ");
    where.append(at);
    by("rest-row").replaceChildren(
      button("Continue", "continue", () => {
        const proven = session.state?.proven;
        if (proven)
          session.link.act({
            what: "continue",
            run: chosen()?.run ?? "",
            at: at.value,
            proof: proven.proof,
            override: program.reason(proven),
          });
      }),
      where,
      button("Go there", "approach-rest", () => session.hold({ what: "approach-rest" })),
      button("Start the rest", "start-rest", () => session.link.act({ what: "start-rest" })),
    );
  }

  /** Why a run has no rest that can be run; empty if it has one. */
  whole(run: Kept | null): string {
    return run === null
      ? "no run is stored"
      : WHOLE.has(run.ended)
        ? `the run was ${run.ended}: nothing of it is left to do`
        : "";
  }

  show(state: State, run: Kept | null): void {
    const whole = state.rest ? "" : this.whole(run);
    put(by("rest-row"), "hidden", whole !== "");
    const notes = state.rest
      ? [state.rest.run, ...state.rest.notes, "Start the rest confirms; a stop discards it"]
      : run === null
        ? []
        : [whole ? `${run.run}: ${whole}` : hintOf(this.session)];
    if (notes.join("\n") === this.shown) return;
    this.shown = notes.join("\n");
    by("rest-notes").replaceChildren(...notes.map((line) => made("li", line)));
  }
}
