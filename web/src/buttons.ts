/** Which buttons can be pressed now, and why the others cannot. */

import { STEP_PERCENT } from "./bar";
import type { Continuing } from "./continuing";
import { put } from "./dom";
import type { Jogging } from "./jogging";
import type { State } from "./messages";
import type { Program } from "./program";
import type { Session } from "./session";
import type { Teach } from "./teach";
import type { Traces } from "./traces";

/** Commands for part programs, and commands that need a homed machine. */
const OF_PROGRAMS = new Set(["teach", "zero-here"]);
const BY_PLACE = new Set(["jog", "step", "zero", "zero-axis"]);
const OF_CALCULATION = new Set(["start", "approach"]);
/** Commands that need no data of the machine: where its link is gone none come any more. */
const WITHOUT_DATA = new Set(["reconnect", "calculate", "cancel"]);
const HOME_FIRST = "home first: the positions of the axes are unknown";

export class Buttons {
  constructor(
    private readonly session: Session,
    private readonly jogging: Jogging,
    private readonly program: Program,
    private readonly teach: Teach,
    private readonly traces: Traces,
    private readonly continuing: Continuing,
  ) {}

  /**
   * @param stale whether the data of the machine are too old to command it by them
   * @param deaf whether nothing comes from the panel itself
   */
  show(state: State | null, stale: boolean, deaf: boolean): void {
    const changed = state !== null && this.program.changed(state);
    const unreasoned = state !== null && this.program.wantsReason(state);
    for (const one of document.querySelectorAll<HTMLButtonElement>("button[data-what]")) {
      const what = one.dataset.what!;
      const waits =
        (what === "start" && unreasoned) ||
        (what === "calculate" && !this.program.chosen) ||
        (changed && OF_CALCULATION.has(what));
      const may =
        !(WITHOUT_DATA.has(what) ? deaf : stale) && this.can(one, what, state) && !waits && !this.ends(one);
      put(one, "disabled", !this.jogging.keeps(one) && !may);
      put(one, "title", this.why(one, what, state));
    }
  }

  /** Whether it is a step of the feed beyond what was proven. */
  private ends(one: HTMLButtonElement): boolean {
    const by = { slower: -STEP_PERCENT, faster: STEP_PERCENT }[one.id];
    return by !== undefined && this.session.overriddenBy(by) === null;
  }

  private can(one: HTMLButtonElement, what: string, state: State | null): boolean {
    if (OF_PROGRAMS.has(what)) return this.teach.can(state);
    if (this.ofChosen(one, what) && this.continuing.whole(this.traces.chosen) !== "") return false;
    return this.session.can(what);
  }

  /** Whether a button continues the run that is chosen in the table of runs. */
  private ofChosen(one: HTMLButtonElement, what: string): boolean {
    return what === "continue" && one.dataset.here === undefined;
  }

  private why(one: HTMLButtonElement, what: string, state: State | null): string {
    const { session } = this;
    const homeless =
      state !== null && session.mine() && (state.state === "disabled" || state.state === "enabled");
    const refused = state?.no_override ? `this run cannot be overridden: ${state.no_override}` : "";
    const overridden = refused || (session.can(what) && "10 to 100 % of the feed: a proof covers no more");
    const byPlace = session.byHand ? homeless && HOME_FIRST : "this machine cannot be moved by hand";
    return (
      session.lacking(what) ||
      (OF_PROGRAMS.has(what) && session.untaught) ||
      (this.ofChosen(one, what) && this.continuing.whole(this.traces.chosen)) ||
      (BY_PLACE.has(what) && byPlace) ||
      (what === "start" && homeless && one.disabled && HOME_FIRST) ||
      (what === "override-feed" && overridden) ||
      (what === "calculate" && session.mine() && !this.program.chosen && "choose or load a program first") ||
      (one.disabled && state !== null && session.waits(what)) ||
      ""
    );
  }
}
