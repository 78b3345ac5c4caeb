/** Buttons of the operator's own: a name, and steps that the panel allows one after the other. */

import { by, made, put, tell, value } from "./dom";
import type { State } from "./messages";
import type { Program } from "./program";
import type { Session } from "./session";
import { say } from "./toasts";

/** A step of a button; ``what`` is the command that the panel must allow. */
export interface OwnStep {
  what: string;
  /** The line of the button's text, for messages. */
  text: string;
  percent?: number;
  line?: string;
  program?: string;
  priority?: string;
}

/** What the machine has that steps may need. */
export interface Has {
  console: boolean;
  feedOverride: boolean;
  normalFeed: boolean;
}

export interface Own {
  name: string;
  text: string;
}

const PLAIN = ["enable", "disable", "home", "reset", "hold", "resume"];
const PRIORITIES: Record<string, string> = { careful: "accuracy", normal: "optimum", fastest: "speed" };
const KNOWN = `${PLAIN.join(", ")}, program NAME, feed N %, line TEXT`;
/** Commands with a button or a key that must be seen, held or confirmed. */
const BY_HAND = new Set(["start", "approach", "jog", "step", "zero", "continue", "stop"]);
const MOST_BUTTONS = 12;
const MOST_STEPS = 20;
/** Commands that take time: the next step waits until the machine stands and nothing is calculated. */
const LASTS = new Set(["enable", "disable", "home", "reset", "calculate"]);
const LATER = 3; // number of states after an answer until its effect shows

/** The steps of a text, one on each line; a sentence that says what is wrong. */
export function stepsOf(text: string, has: Has): OwnStep[] | string {
  const found: OwnStep[] = [];
  for (const [k, raw] of text.split("\n").entries()) {
    const line = raw.trim();
    if (line === "") continue;
    const step = stepOf(line, has);
    if (typeof step === "string") return `step ${k + 1}, "${line}": ${step}`;
    found.push(step);
  }
  if (found.length > MOST_STEPS) return `it has ${found.length} steps, and may have ${MOST_STEPS}`;
  return found.length ? found : `a button needs a step: ${KNOWN}`;
}

function stepOf(text: string, has: Has): OwnStep | string {
  const [word, ...rest] = text.split(/\s+/);
  const more = rest.join(" ");
  if (BY_HAND.has(word!))
    return `${word} is not a step: it has its own button, which somebody presses who looks`;
  if (PLAIN.includes(word!)) return more ? `${word} stands alone` : { what: word!, text };
  if (word === "feed") return feedStep(text, more, has);
  if (word === "line") {
    if (!has.console) return "this machine takes no typed lines";
    return more ? { what: "console", text, line: more } : "the line is missing: line $G";
  }
  if (word === "program") return programStep(text, more, has);
  return `it is none of ${KNOWN}`;
}

function feedStep(text: string, more: string, has: Has): OwnStep | string {
  const percent = Number(more.replace(/\s*%$/, ""));
  if (!has.feedOverride) return "this machine has no feed that can be overridden";
  if (!(percent >= 10 && percent <= 100) || !Number.isInteger(percent))
    return "the feed is a whole number from 10 to 100 %: a proof covers no more";
  return { what: "override-feed", text, percent };
}

function programStep(text: string, more: string, has: Has): OwnStep | string {
  const words = more.split(" ");
  const priority = words.length > 1 ? PRIORITIES[words[words.length - 1]!] : undefined;
  const program = priority ? words.slice(0, -1).join(" ") : more;
  if (program === "") return "the name is missing: program strap.prg careful";
  if (priority === "accuracy" && !has.normalFeed)
    return "careful needs the operator's normal feed in the machine file";
  return { what: "calculate", text, program, priority: priority ?? "programmed" };
}

/** Sends a step for a runner, and returns the number of the command; 0 if none was sent. */
export type Send = (step: OwnStep) => number;

/** Goes through the steps of a button; ends at the first that is refused, and at any trouble. */
export class Runner {
  private left: OwnStep[] = [];
  private now: OwnStep | null = null;
  private number = 0; // of the command that is not answered yet
  private answeredAt = -1; // the state that was the latest at the answer

  constructor(
    private readonly send: Send,
    private readonly ended: (why: string) => void,
  ) {}

  get busy(): boolean {
    return this.now !== null || this.left.length > 0;
  }

  begin(steps: OwnStep[]): void {
    if (!this.busy) this.left = [...steps];
  }

  /** End it; whatever a step began goes on. */
  stop(why = ""): void {
    if (!this.busy) return;
    const at = this.now ?? this.left[0]!;
    [this.left, this.now, this.number, this.answeredAt] = [[], null, 0, -1];
    if (why) this.ended(`"${at.text}": ${why}`);
  }

  answered(number: number, ok: boolean, seq: number): void {
    if (!this.now || number !== this.number) return;
    if (ok) [this.number, this.answeredAt] = [0, seq];
    else this.stop("it was refused, and the steps after it are left out");
  }

  /** Look at a state: go on where the step before is done. */
  look(state: State, mine: boolean): void {
    if (!this.busy) return;
    const trouble = this.trouble(state, mine);
    if (trouble) this.stop(trouble);
    if (trouble) return;
    if (this.now && !this.done(state)) return;
    const next = this.left[0];
    if (!next) {
      [this.now, this.answeredAt] = [null, -1];
      return;
    }
    const may = state.allowed.includes(next.what);
    if (!may && !state.busy) this.stop(`not possible now: the machine is ${state.state}`);
    if (!may) return; // or a run is judged, or a start is checked
    this.left.shift();
    [this.now, this.answeredAt] = [next, -1];
    this.number = this.send(next);
    if (this.number === 0) this.stop("there is no such program in the folder");
  }

  /** Why no step is taken any more; empty if they go on. */
  private trouble(state: State, mine: boolean): string {
    const resets = this.now?.what === "reset" || this.left[0]?.what === "reset";
    if (!mine) return "control is lost";
    const ends = ["gone", "stopping"].includes(state.state) || (state.state === "fault" && !resets);
    return ends ? `the machine is ${state.state}` : "";
  }

  private done(state: State): boolean {
    if (this.answeredAt < 0) return false;
    const { what, program } = this.now!;
    if (!LASTS.has(what)) return true;
    if (state.seq < this.answeredAt + LATER || state.calculating !== null || state.state === "homing")
      return false;
    if (what === "calculate" && state.proven?.program !== program) {
      this.stop("nothing came of the calculation");
      return false;
    }
    return true;
  }
}

/** The buttons that a browser has kept for a machine. */
export function kept(text: string | null): Own[] {
  try {
    const found: unknown = JSON.parse(text ?? "[]");
    if (!Array.isArray(found)) return [];
    return found.filter((one) => typeof one?.name === "string" && typeof one?.text === "string");
  } catch {
    return [];
  }
}

export class OwnButtons {
  private all: Own[] = [];
  private machine = "";
  private readonly runner: Runner;
  private has: Has = { console: false, feedOverride: false, normalFeed: false };

  constructor(
    private readonly session: Session,
    private readonly program: Program,
  ) {
    this.runner = new Runner(
      (step) => this.send(step),
      (why) => say(`Own button ended at ${why}`, true),
    );
    session.link.stopped = () => this.runner.stop("it was stopped");
    by("own-save").onclick = () => this.save();
  }

  build(machine: string, console: boolean): void {
    const { feedOverride, normalFeed } = this.session;
    [this.machine, this.has] = [machine, { console, feedOverride, normalFeed }];
    this.runner.stop();
    this.all = kept(this.stored());
    this.list();
  }

  private stored(): string | null {
    try {
      return localStorage.getItem(this.key);
    } catch {
      return null; // a browser that stores nothing
    }
  }

  private get key(): string {
    return `own buttons of ${this.machine}`;
  }

  private send(step: OwnStep): number {
    const { link } = this.session;
    if (step.what === "calculate") return this.program.calculateAs(step.program!, step.priority!);
    if (step.what === "override-feed") return link.act({ what: step.what, percent: step.percent });
    return link.act(step.line === undefined ? { what: step.what } : { what: step.what, line: step.line });
  }

  private save(): void {
    const own = { name: value("own-name"), text: value("own-steps") };
    const steps = stepsOf(own.text, this.has);
    const others = this.all.filter((one) => one.name !== own.name);
    const full = others.length >= MOST_BUTTONS ? `there are ${MOST_BUTTONS} already: remove one` : "";
    const wrong = own.name === "" ? "a button needs a name" : typeof steps === "string" ? steps : full;
    tell("own-wrong", wrong && `Not saved: ${wrong}.`);
    if (wrong) return;
    this.keep([...others, own]);
    for (const id of ["own-name", "own-steps"]) by<HTMLInputElement>(id).value = "";
  }

  private keep(all: Own[]): void {
    this.all = all;
    this.list();
    try {
      localStorage.setItem(this.key, JSON.stringify(all));
    } catch {
      say("This browser stores nothing: the buttons are lost with this page.", true);
    }
  }

  private list(): void {
    const pressed = (own: Own) => {
      const found = made("button", own.name);
      found.type = "button";
      found.title = own.text;
      found.onclick = () => {
        const steps = stepsOf(own.text, this.has);
        if (typeof steps === "string") say(`${own.name}: ${steps}`, true);
        else this.runner.begin(steps);
      };
      return found;
    };
    const edited = (own: Own) => {
      const row = made("li", `${own.name} `);
      const [change, remove] = [made("button", "change"), made("button", "remove")];
      for (const one of [change, remove]) [one.type, one.className] = ["button", "link"];
      change.setAttribute("aria-label", `Change ${own.name}`);
      remove.setAttribute("aria-label", `Remove ${own.name}`);
      change.onclick = () => {
        by<HTMLInputElement>("own-name").value = own.name;
        by<HTMLTextAreaElement>("own-steps").value = own.text;
        by("own-name").focus();
      };
      remove.onclick = () => this.keep(this.all.filter((one) => one !== own));
      row.append(change, " ", remove);
      return row;
    };
    by("own-buttons").replaceChildren(...this.all.map(pressed));
    put(by("own-buttons"), "hidden", this.all.length === 0);
    by("own-list").replaceChildren(...this.all.map(edited));
  }

  answered(number: number, ok: boolean): void {
    this.runner.answered(number, ok, this.session.state?.seq ?? 0);
  }

  show(state: State): void {
    const mine = this.session.mine();
    this.runner.look(state, mine);
    for (const [k, one] of [...by("own-buttons").children].entries()) {
      const steps = stepsOf(this.all[k]!.text, this.has);
      const first = typeof steps === "string" ? "" : steps[0]!.what;
      const may = mine && !this.runner.busy && (first === "" || state.allowed.includes(first));
      put(one as HTMLButtonElement, "disabled", !may);
      const why = this.runner.busy ? "a button's steps are under way" : this.session.waits(first);
      put(one as HTMLButtonElement, "title", may ? this.all[k]!.text : why);
    }
  }
}
