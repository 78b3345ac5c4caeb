/** Positions in large digits, with command, distance to go and travel; inputs and outputs. */

import { by, made, put, tell } from "./dom";
import type { State } from "./messages";
import type { Session } from "./session";
import { unitOf } from "./session";
import { isHomed, unknownPlace } from "./wording";

const MORE_MS = 190; // between two looks at command, distance and travel while an axis moves

export class Positions {
  private told = ""; // the shown signals, as JSON
  private moreMs = Number.NEGATIVE_INFINITY; // when command, distance and travel were last shown

  constructor(private readonly session: Session) {}

  /** A row for an axis, or for another moving body. */
  row(name: string): HTMLTableRowElement {
    const row = made("tr");
    const head = made("th", name);
    const cell = made("td");
    const at = made("span");
    const digits = made("span");
    const unit = made("small");
    const more = made("small");
    const axis = this.session.axes.find((one) => one.name === name);
    head.scope = "row";
    at.id = `at-${name}`;
    at.className = "number";
    digits.id = `digits-${name}`;
    unit.id = `unit-${name}`; // in a column of its own, so that the decimal points of the axes are in line
    at.append(digits, unit);
    more.id = `more-${name}`;
    more.className = "more";
    cell.className = "place";
    cell.append(at, more);
    if (axis && axis.low !== null && axis.high !== null) {
      const travel = made("span");
      const mark = made("i");
      mark.id = `travel-${name}`;
      travel.className = "travel";
      travel.title = `travel of ${name}`;
      travel.append(mark);
      cell.append(travel);
    }
    row.append(head, cell);
    return row;
  }

  show(state: State, toGo: Record<string, number>): void {
    const now = performance.now();
    const more = now - this.moreMs >= MORE_MS || !["running", "jogging"].includes(state.state);
    if (more) this.moreMs = now;
    for (const [name, at] of Object.entries(state.axes)) {
      if (!document.getElementById(`at-${name}`)) by("axes").append(this.row(name));
      const [scale, unit] = unitOf(this.session, name);
      const where = at.measured ?? at.load ?? at.commanded;
      const own = this.session.axes.find((axis) => axis.name === name);
      const unknown = unknownPlace(own === undefined && isHomed(state.state));
      tell(`digits-${name}`, where === null ? unknown : shown(where * scale));
      tell(`unit-${name}`, where === null ? "" : ` ${unit}`);
      put(by(`at-${name}`), "className", where === null ? "number unknown" : "number");
      if (!more) continue;
      const commanded = at.commanded === null || where === null ? null : at.commanded * scale;
      const left = toGo[name];
      const parts = [
        commanded === null ? "" : `command ${shown(commanded)}`,
        left === undefined ? "" : `to go ${shown(left * scale)}`,
      ];
      tell(`more-${name}`, parts.filter(Boolean).join(",\n"));
      const mark = document.getElementById(`travel-${name}`);
      if (mark && own) {
        const share = where === null ? 0 : (where - own.low!) / (own.high! - own.low!);
        const left_ = `${Math.round(200 * Math.min(Math.max(share, 0), 1)) / 2}%`; // half a per cent is a pixel
        if (mark.style.left !== left_) mark.style.left = left_;
        put(mark, "hidden", where === null);
      }
    }
    this.showSignals(state);
  }

  private showSignals(state: State): void {
    const signals = Object.entries(state.signals);
    const told = JSON.stringify(signals);
    if (told === this.told) return; // states come 20 times a second: lay out only changes
    this.told = told;
    by("signals").replaceChildren(
      ...signals.map(([name, on]) => {
        const found = made("span", `${name.replaceAll("_", " ")} ${on ? "on" : "off"}`);
        found.className = on ? "on" : "";
        return found;
      }),
    );
    put(by("signals"), "hidden", signals.length === 0);
  }
}

/** A position with two decimals, and no minus before zero. */
export function shown(size: number): string {
  return (size + 0).toFixed(2).replace(/^-0\.00$/, "0.00");
}
