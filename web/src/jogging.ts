/** Manual operation: positions; jogs, while a button or key is held; steps. */

import { STEP_PERCENT } from "./bar";
import { button, by, made, put, typing, value, writing } from "./dom";
import type { Axis } from "./messages";
import type { Positions } from "./positions";
import type { Session } from "./session";
import { unitOf } from "./session";

const SHARES = [5, 10, 25, 50, 75, 100];
const SHOWN: Record<string, string> = {
  ArrowLeft: "←",
  ArrowRight: "→",
  ArrowDown: "↓",
  ArrowUp: "↑",
  PageDown: "PgDn",
  PageUp: "PgUp",
};
const IGNORED = new Set(["Shift", "Control", "Alt", "AltGraph", "Meta", "Tab", "CapsLock", "NumLock"]);
/** Elements that Enter presses; elsewhere Enter is a key like the others. */
const PRESSED = "button, summary, input[type=checkbox], input[type=radio], input[type=file]";

type Way = { axis: string; sign: number };

export class Jogging {
  private readonly keys = new Map<string, Way>();
  private held = ""; // the key that moves an axis
  private moved = false; // whether anything moved when the state was last shown
  private pressed: HTMLButtonElement | null = null; // the button that moves an axis, or last moved one

  constructor(
    private readonly session: Session,
    private readonly positions: Positions,
  ) {
    by<HTMLInputElement>("share").oninput = () => this.tellShare();
    window.addEventListener("keydown", (event) => this.keyed(event), true);
    window.addEventListener(
      "keyup",
      (event) => {
        if (event.key === this.held) this.end();
      },
      true,
    );
    window.addEventListener("mousedown", (event) => this.chosen(event), true);
    window.addEventListener("blur", () => {
      this.held = "";
      session.letGo();
    });
    document.addEventListener("visibilitychange", () => {
      if (document.hidden) {
        this.held = "";
        session.letGo();
      }
    });
  }

  build(): void {
    const { session } = this;
    const simple = (text: string, what: string) => button(text, what, () => session.link.act({ what }));
    by("commands").replaceChildren(
      simple("Enable", "enable"),
      simple("Disable", "disable"),
      simple("Home all", "home"),
      button("Zero all", "zero", () => session.hold({ what: "zero" })),
      simple("Reset", "reset"),
      simple("Reconnect", "reconnect"),
    );
    put(by("commands").querySelector<HTMLElement>("[data-what=zero]")!, "hidden", !session.byHand);
    this.keys.clear();
    const pairs: Record<string, [string, string]> = {
      X: ["ArrowRight", "ArrowLeft"],
      Y: ["ArrowUp", "ArrowDown"],
    };
    const third = session.axes.find((axis) => !(axis.name in pairs));
    if (third) pairs[third.name] = ["PageUp", "PageDown"];
    by("axes").replaceChildren(...session.axes.map((axis) => this.row(axis, pairs[axis.name])));
    const byHand = session.byHand && session.axes.length > 0;
    for (const one of [by("jogs"), by("keys-told")]) put(one, "hidden", !byHand);
    this.disarm();
  }

  private row(axis: Axis, pair: [string, string] | undefined): HTMLTableRowElement {
    const row = this.positions.row(axis.name);
    const { session } = this;
    if (!session.byHand) return row; // without motion by hand there are no jog buttons
    const cell = (...inside: Node[]) => {
      const found = made("td");
      found.append(...inside);
      return found;
    };
    const jog = (sign: number, key: string | undefined) => {
      if (key) this.keys.set(key, { axis: axis.name, sign });
      const found = made("button", sign > 0 ? "+" : "−");
      if (key) found.dataset.key = SHOWN[key];
      found.type = "button";
      found.dataset.what = "jog";
      found.setAttribute("aria-label", `Jog ${axis.name} ${sign > 0 ? "plus" : "minus"} while held`);
      found.onpointerdown = (event) => {
        found.setPointerCapture(event.pointerId);
        this.pressed = found;
        this.begin({ axis: axis.name, sign });
      };
      found.onpointerup = found.onpointercancel = found.onlostpointercapture = () => this.end();
      found.onkeydown = (event) => {
        if (event.key === "Enter" && !event.repeat) {
          event.preventDefault();
          this.pressed = found;
          this.begin({ axis: axis.name, sign });
        }
      };
      found.onkeyup = (event) => {
        if (event.key === "Enter") this.end();
      };
      found.onblur = () => {
        if (session.moves) this.end();
      };
      found.oncontextmenu = (event) => event.preventDefault();
      return found;
    };
    row.append(
      cell(jog(-1, pair?.[1])),
      cell(jog(1, pair?.[0])),
      cell(
        button(`Zero ${axis.name}`, "zero-axis", () =>
          this.session.hold({ what: "zero-axis", axis: axis.name }),
        ),
      ),
    );
    return row;
  }

  private begin(way: Way): void {
    const step = value("step");
    if (step === "")
      this.session.hold({ what: "jog", axis: way.axis, share: (way.sign * Number(value("share"))) / 100 });
    else
      this.session.hold({
        what: "step",
        axis: way.axis,
        by: (way.sign * Number(step)) / unitOf(this.session, way.axis)[0],
      });
  }

  /** Whether a button stays enabled in motion: a disabled button loses the focus, which would end the motion and lose the next Enter. */
  keeps(button: HTMLButtonElement): boolean {
    return button === this.pressed && (this.session.moves || button === document.activeElement);
  }

  private end(): void {
    this.held = "";
    if (value("step") === "") this.session.letGo();
    else this.session.runOut();
  }

  /** Whether the machine moves, or will move without another command because a start is being checked. */
  private moving(): boolean {
    return this.session.moves || this.session.machineMoves() || this.session.starts();
  }

  /** A key pressed during a motion ends the motion, whatever has the focus: fields and lists do not get it. */
  private keyed(event: KeyboardEvent): void {
    const { session } = this;
    const take = () => {
      event.preventDefault();
      event.stopPropagation();
    };
    if (event.key === "Escape" || (event.key === " " && (this.moving() || !writing()))) {
      take();
      this.held = "";
      session.letGo();
      session.link.stop();
      return;
    }
    if (
      event.key === "Enter" &&
      event.target instanceof HTMLInputElement &&
      ["checkbox", "radio"].includes(event.target.type) &&
      !event.target.disabled
    ) {
      event.target.click();
      return;
    } // in place of the space bar, which stops
    if (event.ctrlKey || event.altKey || event.metaKey || IGNORED.has(event.key)) return;
    if (event.key === "Enter" && event.target instanceof Element && event.target.matches(PRESSED)) return;
    if (session.moves) {
      // any key ends a jog or step
      take();
      if (event.repeat) return;
      this.held = "";
      session.letGo();
      return;
    }
    if (session.mine() && this.moving()) {
      take();
      if (!event.repeat) this.inRun(event.key);
      return;
    }
    if (event.key === "Enter" || typing() || !["run", "teach-in"].includes(document.body.dataset.part ?? ""))
      return; // the key belongs to the field, list or drawing
    const way =
      by<HTMLInputElement>("by-keys").checked && session.mine() ? this.keys.get(event.key) : undefined;
    if (way) event.preventDefault(); // the page does not scroll
    if (event.repeat) return;
    if (way) {
      this.held = event.key;
      this.begin(way);
    } else if ("+-".includes(event.key)) {
      const at = SHARES.findIndex((share) => share >= Number(value("share")));
      by<HTMLInputElement>("share").value = String(
        SHARES[Math.min(Math.max(at + (event.key === "+" ? 1 : -1), 0), SHARES.length - 1)],
      );
      this.tellShare();
    }
  }

  /** During a motion a list does not open, since it would take the keys: a press chooses its next entry. */
  private chosen(event: MouseEvent): void {
    const list = event.target instanceof Element ? event.target.closest("select") : null;
    if (!list || !this.moving()) return;
    event.preventDefault();
    if (list.disabled || list.options.length < 2) return;
    list.selectedIndex = (list.selectedIndex + 1) % list.options.length;
    for (const kind of ["input", "change"]) list.dispatchEvent(new Event(kind, { bubbles: true }));
  }

  /** In a run h holds, r resumes, - and + override the feed, any other key stops. */
  private inRun(key: string): void {
    const what = { h: "hold", r: "resume" }[key];
    const step = { "-": -STEP_PERCENT, "+": STEP_PERCENT }[key];
    if (step !== undefined) this.session.overrideFeed(step);
    else if (what === undefined) this.session.link.stop();
    else if (this.session.can(what)) this.session.link.act({ what });
  }

  private tellShare(): void {
    by("share-shown").textContent = `${value("share")} %`;
  }

  /** Disarm jogging by keys, until the operator arms it again. */
  disarm(): void {
    this.held = "";
    by<HTMLInputElement>("by-keys").checked = false;
  }

  show(): void {
    const arm = by<HTMLInputElement>("by-keys");
    put(arm, "disabled", !this.session.mine() || this.session.axes.length === 0);
    if (arm.disabled) this.disarm();
    const moving = this.moving();
    if (moving && !this.moved && document.activeElement instanceof HTMLSelectElement)
      document.activeElement.blur(); // an open list would take the keys
    this.moved = moving;
    for (const file of document.querySelectorAll<HTMLInputElement>("input[type=file]"))
      put(file, "disabled", moving || (file.id === "file" && !this.session.mine())); // a file dialog would take the keys
  }
}
