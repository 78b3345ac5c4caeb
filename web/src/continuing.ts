/** The rest of an interrupted run: choose a stored run, approach its place, confirm. */

import { button, by, made } from "./dom";
import type { State } from "./messages";
import type { Program } from "./program";
import type { Session } from "./session";
import type { Kept } from "./traces";

const HINT =
  "To continue an interrupted run: load its program, calculate it with the same options, home the machine, then choose the run.";
/** Ends after which a run has no rest; see ``store/unfinished.py``. */
const WHOLE = new Set(["completed", "refused"]);

export class Continuing {
  private shown = "";

  constructor(session: Session, program: Program, chosen: () => Kept | null) {
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
    by("rest-told").replaceChildren(made("li", HINT));
  }

  /** Why a run has no rest that can be run; empty if it has one. */
  whole(run: Kept | null): string {
    return run === null
      ? "no run is stored"
      : WHOLE.has(run.ended)
        ? `the run was ${run.ended}: there is no rest of it`
        : "";
  }

  show(state: State, run: Kept | null): void {
    const told = state.rest
      ? [state.rest.run, ...state.rest.told, "Start the rest confirms; a stop discards it"]
      : [HINT, ...(run && this.whole(run) ? [`${run.run}: ${this.whole(run)}`] : [])];
    if (told.join("\n") === this.shown) return;
    this.shown = told.join("\n");
    by("rest-told").replaceChildren(...told.map((line) => made("li", line)));
  }
}
