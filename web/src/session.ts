/** The page's session at the panel: its number, the machine, and the commands that are possible now. */

import { deviceName } from "./device";
import { Link } from "./link";
import type { Axis, Cylinder, Figures, FromPanel, State, Welcome } from "./messages";
import { verdictOfBlindRun, verdictOfRun } from "./wording";

const RENEW_MS = 80;
const [LEAST_PERCENT, MOST_PERCENT] = [10, 100]; // the panel refuses more
const STARTS = "a start is being checked"; // a text of the panel
/** Commands that wait until the panel is no longer busy. */
const FOR_RUNS = new Set(["start", "start-rest", "continue", "calculate"]);
const MOVING = new Set(["homing", "jogging", "running", "holding", "stopping"]);

export class Session {
  readonly link: Link;
  me = 0;
  axes: Axis[] = [];
  cylinders: Cylinder[] = [];
  /** Whether the axes can be moved by hand. */
  byHand = true;
  /** Whether the feed of a run can be overridden. */
  feedOverride = true;
  /** Planning options that apply to the machine. */
  options: string[] = [];
  /** Whether its work are designs of stitches: neither axes that move by hand nor cylinders. */
  embroiders = false;
  /** Whether the machine has an operator's normal feed. */
  normalFeed = false;
  /** Commands that this link lacks, and why. */
  lacks: Record<string, string> = {};
  figures: Figures | null = null;
  /** Number of the state before the figures came. */
  figuresAt = 0;
  private readonly renewals = new Set<number>(); // not answered yet
  private renews = 0; // number of the timer that renews a motion; 0 for none

  constructor(heard: (message: FromPanel) => void, lost: () => void) {
    this.link = new Link(
      deviceName(navigator.userAgent),
      new URLSearchParams(location.hash.slice(1)).get("token") ?? kept(""),
      heard,
      () => {
        this.letGo();
        this.renewals.clear();
        lost();
      },
    );
  }

  /** Take the greeting of a panel: it counts its states from 0, and sends its figures. */
  welcome(found: Welcome): void {
    this.me = found.client;
    this.axes = found.axes;
    this.cylinders = found.cylinders;
    this.lacks = found.lacks;
    this.untaught = found.untaught;
    this.byHand = found.by_hand;
    this.feedOverride = found.feed_override;
    this.options = found.options;
    this.normalFeed = found.normal_feed;
    this.embroiders = !found.by_hand && found.cylinders.length === 0;
    this.figuresAt = 0;
  }

  get state(): State | null {
    return this.link.state;
  }
  get moves(): boolean {
    return this.renews !== 0;
  }
  mine(): boolean {
    return this.link.lease !== "" && this.state?.control.client === this.me;
  }
  can(what: string): boolean {
    return this.mine() && (this.state?.allowed.includes(what) ?? false);
  }
  /** Override the feed of the run by a step; nothing beyond 10 to 100 %, which were proven. */
  overrideFeed(by: number): void {
    const percent = this.overriddenBy(by);
    if (percent !== null) this.link.act({ what: "override-feed", percent });
  }
  /** The feed after a step, %; null where there is no such step now. */
  overriddenBy(by: number): number | null {
    if (!this.can("override-feed")) return null;
    const now = this.state!.feed_percent;
    const percent = Math.min(Math.max(now + by, LEAST_PERCENT), MOST_PERCENT);
    return percent === now ? null : percent;
  }
  /** Why no part program can be taught to this machine; empty if one can. */
  untaught = "";
  /** Why this link lacks a command; empty if it has it. */
  lacking(what: string): string {
    return what in this.lacks ? `not available on this link: ${this.lacks[what]}` : "";
  }
  machineMoves(): boolean {
    return MOVING.has(this.state?.state ?? "");
  }
  /** Whether a run is about to begin. */
  starts(): boolean {
    return this.state?.busy === STARTS;
  }
  /** Why a command is not possible now. */
  waits(what: string): string {
    if (!this.mine()) return "take control first";
    const state = this.state!;
    return `not possible now: the machine is ${state.state}${state.busy && FOR_RUNS.has(what) ? `, and ${state.busy}` : ""}`;
  }

  /** Send a token to the panel, and keep it while this tab is open. */
  knock(token: string): void {
    kept(token);
    this.link.knock(token);
  }

  /** Begin a motion that lasts only while the page renews it; a refused renewal means that it has ended. */
  hold(command: { what: string; [key: string]: unknown }): void {
    this.letGo();
    if (!this.can(command.what)) return;
    this.link.act(command);
    this.renews = window.setInterval(() => {
      if (document.hidden || !this.mine()) {
        this.letGo();
        return;
      }
      this.renewals.add(this.link.act({ what: "renew" }));
    }, RENEW_MS);
  }

  /** Whether an answer belongs to a renewal; a refused renewal means that the motion is over. */
  renewal(number: number): boolean {
    return this.renewals.delete(number);
  }

  letGo(): void {
    if (this.endsRenewing()) this.link.act({ what: "let-go" });
  }

  /** Let the lease of a motion run out: a short step is finished, a long one stops within 250 ms. */
  runOut(): void {
    this.endsRenewing();
  }

  private endsRenewing(): boolean {
    if (this.renews === 0) return false;
    clearInterval(this.renews);
    this.renews = 0;
    return true;
  }

  async ask(path: string, more: RequestInit = {}): Promise<Response> {
    return fetch(path, {
      ...more,
      headers: { Authorization: `Bearer ${this.link.token}`, "X-Lease": this.link.lease, ...more.headers },
    });
  }
}

/** Return the token kept by this tab; a given one is kept first. A browser that stores nothing asks again. */
function kept(token: string): string {
  try {
    if (token) sessionStorage.setItem("token", token);
    return sessionStorage.getItem("token") ?? "";
  } catch {
    return token;
  }
}

/** Factor and unit in which an axis or another moving body is shown. */
export function unitOf(session: Session, name: string): [number, string] {
  const bodies: { name: string; unit: string }[] = [...session.axes, ...session.cylinders];
  return bodies.find((one) => one.name === name)?.unit === "rad" ? [180 / Math.PI, "°"] : [1000, "mm"];
}

/** How and why a run ended: "stopped by the operator", "fault: axis X ...". */
export function endOf(ended: string, why: string): string {
  return why === "" ? ended : why.startsWith(ended) ? why : `${ended}: ${why}`;
}

/** Whether a machine tells its commands, and measures none of its positions. */
export function measuresNothing({ axes }: Pick<State, "axes">): boolean {
  const places = Object.values(axes);
  return (
    places.some((at) => at.commanded !== null) &&
    !places.some((at) => at.measured !== null || at.load !== null)
  );
}

/** How the last run of this panel ended, with its verdict, if there is one. */
export function toldRun(state: State): string {
  return `${state.progress!.program}: ${toldEnd(state)}`;
}

/** The same without the name of its program, for a place that names it already. */
export function toldEnd(state: State): string {
  const { ended, why, verdict } = state.progress!;
  const words = measuresNothing(state) ? verdictOfBlindRun(verdict) : verdictOfRun(verdict);
  return `${endOf(ended ?? "", why !== "" && words.includes(why) ? "" : why)}. ${words}`.trim();
}
