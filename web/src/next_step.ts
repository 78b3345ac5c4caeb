/** The next step of an operator: the button to press next, and its place. */

import type { State } from "./messages";

export interface Step {
  /** The command whose button is marked. */
  what: string;
  text: string;
  part: "prepare" | "run" | "";
}

/** The page's knowledge besides the state. */
export interface Known {
  mine: boolean;
  /** Whether a program is chosen. */
  chosen: boolean;
  /** Whether program or fields differ from the calculation. */
  changed: boolean;
  /** Whether a start lacks its reason to run out of specification. */
  wantsReason: boolean;
  /** Whether the axes stand where the program begins. */
  atStart: boolean;
}

/** Return the next step; null where the operator waits, or another has control. */
export function nextStep(state: State, known: Known): Step | null {
  const may = (what: string) => state.allowed.includes(what);
  if (!known.mine)
    return state.control.client === null ? { what: "take", text: "take control", part: "" } : null;
  if (state.state === "holding") return { what: "resume", text: "resume, or stop", part: "" };
  if (may("reset") && state.state === "fault") return { what: "reset", text: "reset the fault", part: "run" };
  if (["fault", "gone"].includes(state.state) && may("reconnect"))
    return { what: "reconnect", text: "reconnect the machine", part: "run" };
  if (state.state === "disabled" && may("enable"))
    return { what: "enable", text: "enable the drives", part: "run" };
  if (state.state === "enabled" && may("home"))
    return { what: "home", text: "home the machine", part: "run" };
  if (state.state === "idle" && state.busy) return { what: "", text: `wait, ${state.busy}`, part: "" };
  if (state.state !== "idle" || state.calculating !== null) return null;
  if (!known.chosen) return { what: "load", text: "load a program", part: "prepare" };
  if (!state.proven || known.changed) return { what: "calculate", text: "calculate it", part: "prepare" };
  if (known.wantsReason)
    return { what: "reason", text: "out of spec: change it, or give a reason", part: "prepare" };
  if (!known.atStart && may("approach")) return { what: "approach", text: "hold Approach down", part: "" };
  if (!known.atStart && may("home"))
    return { what: "home", text: "home the machine: the program begins there", part: "run" };
  return may("start") ? { what: "start", text: "start", part: "" } : null;
}
