/** A cycle of cylinders: its steps, a schematic of cylinders and contacts, and a timing diagram. */

import { made } from "./dom";
import type { State } from "./messages";
import { shown } from "./positions";
import type { Picture, Shown } from "./view";
import { sizeOf } from "./visibility";
import { before } from "./wording";

const SVG = "http://www.w3.org/2000/svg";
const ROW = 18;
const HEAD = 22;
const LEFT = 110;
const CURVE = 54;

function part(name: string, words: Record<string, string | number>, text = ""): SVGElement {
  const found = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(words)) found.setAttribute(key, String(value));
  if (text) found.textContent = text;
  return found;
}

/** Spans in which a lane is on, up to the end of the plan. */
export function spans(on: boolean, changes: number[], end: number): [number, number][] {
  const found: [number, number][] = [];
  let [is, from] = [on, 0];
  for (const time of [...changes, end]) {
    if (is) found.push([from, time]);
    [is, from] = [!is, time];
  }
  return found.filter(([begin, until]) => until > begin);
}

export class Steps implements Picture {
  readonly element = made("div");
  readonly turns = false;
  private readonly list = made("ol");
  private readonly scheme = part("svg", { role: "img", "aria-label": "cylinders, contacts and outputs" });
  private readonly diagram = part("svg", { role: "img", "aria-label": "timing diagram" });
  private job: Shown | null = null;
  private time_s: number | null = null;
  private actual: Record<string, [number, number][]> = {}; // time and position, of the run under way
  private run = "";
  private readonly counted = made("p");
  private cycles = 0;
  private told = ""; // the run that was counted last
  private state: State | null = null;
  private dirty = true;

  constructor() {
    this.element.className = "steps";
    this.list.setAttribute("aria-label", "Steps of the cycle");
    this.counted.className = "hint";
    this.element.append(this.counted, this.list, this.scheme, this.diagram);
  }

  show(job: Shown | null): void {
    this.job = job;
    this.time_s = null;
    this.actual = {};
    this.list.replaceChildren(...(job?.steps ?? []).map((one) => made("li", one.name)));
    this.lay();
    this.dirty = true;
  }

  live(state: State): void {
    this.state = state;
    const run = state.progress;
    if (run && run.run !== this.run) {
      [this.run, this.actual] = [run.run, {}];
      this.lay();
    }
    if (run?.ended === "completed" && run.run !== this.told) {
      [this.told, this.cycles] = [run.run, this.cycles + 1];
      this.counted.textContent = `cycles done since this page was opened: ${this.cycles}`;
    }
    const runs = run && run.ended === null;
    this.time_s = runs ? run.time_s : null;
    if (runs)
      for (const [name, at] of Object.entries(state.axes)) {
        const where = at.load ?? at.measured ?? at.commanded;
        const kept = this.actual[name] ?? [];
        this.actual[name] = kept;
        const last = kept[kept.length - 1];
        if (where !== null && (!last || run.time_s > last[0])) kept.push([run.time_s, where]);
      }
    this.dirty = true;
  }

  at(time_s: number): void {
    this.time_s = Math.min(time_s, this.job?.duration_s ?? 0);
    this.dirty = true;
  }

  legend(): [string, string][] {
    return [
      ["var(--planned)", "planned"],
      ["var(--measured)", "actual"],
    ];
  }

  resize(): void {
    this.lay();
    this.dirty = true;
  }

  draw(): void {
    if (!this.dirty) return;
    this.dirty = false;
    const job = this.job;
    if (!job) return;
    const now =
      this.time_s === null
        ? -1
        : before(
            job.steps.map((one) => one.begin_s),
            this.time_s,
          );
    [...this.list.children].forEach((one, k) => {
      const look = k === now ? "here" : k < now ? "past" : "";
      if (one.className !== look) one.className = look;
      if (k === now) one.setAttribute("aria-current", "step");
      else one.removeAttribute("aria-current");
    });
    this.drawScheme();
    this.drawNow();
  }

  // --- the diagram ----------------------------------------------------------------------------

  private get wide(): number {
    return sizeOf(this.element)[0];
  }

  private x(time_s: number): number {
    return LEFT + ((this.wide - LEFT - 12) * time_s) / Math.max(this.job?.duration_s ?? 1, 1e-3);
  }

  /** Lay out what does not change in a run: the steps, planned positions and lanes. */
  private lay(): void {
    const job = this.job;
    this.diagram.replaceChildren();
    if (!job || job.duration_s === 0) {
      this.diagram.setAttribute("height", "0");
      return;
    }
    const axes = Object.entries(job.planned);
    const lanes = job.lanes.filter((one) => one.changes_s.length);
    const height = HEAD + axes.length * CURVE + lanes.length * ROW + 8;
    this.diagram.setAttribute("width", String(this.wide));
    this.diagram.setAttribute("height", String(height));
    for (const one of job.steps) {
      const x = this.x(one.begin_s);
      this.diagram.append(part("line", { x1: x, x2: x, y1: 0, y2: height, class: "grid" }));
    }
    job.steps.forEach((one, k) => {
      const next = job.steps[k + 1]?.begin_s ?? job.duration_s;
      if (this.x(next) - this.x(one.begin_s) > 7 * one.name.length)
        this.diagram.append(part("text", { x: this.x(one.begin_s) + 3, y: 14 }, one.name));
    });
    axes.forEach(([name, places], k) => {
      const line = places
        .map((at, n) => `${this.x(job.times_s[n]!).toFixed(1)},${this.y(name, at, k)}`)
        .join(" ");
      this.diagram.append(part("text", { x: 4, y: HEAD + k * CURVE + CURVE / 2 }, `${name}, mm`));
      this.diagram.append(part("polyline", { points: line, class: "planned" }));
      this.diagram.append(part("polyline", { points: "", class: "actual", "data-axis": name }));
    });
    lanes.forEach((lane, k) => {
      const y = HEAD + axes.length * CURVE + k * ROW;
      this.diagram.append(part("text", { x: 4, y: y + 13 }, lane.name.replaceAll("_", " ")));
      for (const [from, until] of spans(lane.on, lane.changes_s, job.duration_s))
        this.diagram.append(
          part("rect", {
            x: this.x(from),
            y: y + 4,
            width: Math.max(this.x(until) - this.x(from), 1),
            height: ROW - 8,
            class: lane.input ? "contact" : "output",
          }),
        );
    });
    this.diagram.append(part("line", { x1: 0, x2: 0, y1: 0, y2: height, class: "now" }));
  }

  private y(name: string, at: number, k: number): string {
    const places = this.job!.planned[name]!;
    const [low, high] = [Math.min(...places), Math.max(...places)];
    return (HEAD + (k + 1) * CURVE - 6 - ((CURVE - 14) * (at - low)) / Math.max(high - low, 1e-6)).toFixed(1);
  }

  private drawNow(): void {
    const line = this.diagram.querySelector(".now");
    if (!line) return;
    const x = String(this.time_s === null ? -1 : this.x(this.time_s));
    line.setAttribute("x1", x);
    line.setAttribute("x2", x);
    Object.keys(this.job!.planned).forEach((name, k) => {
      const drawn = this.diagram.querySelector(`[data-axis="${name}"]`);
      const points = (this.actual[name] ?? []).map(
        ([t, at]) => `${this.x(t).toFixed(1)},${this.y(name, at, k)}`,
      );
      drawn?.setAttribute("points", points.join(" "));
    });
  }

  // --- the schematic --------------------------------------------------------------------------

  /** Cylinders with their pistons, and every contact and output as a lamp with its name. */
  private drawScheme(): void {
    const { state } = this;
    if (!state) return;
    const bodies = Object.entries(state.axes);
    const signals = Object.entries(state.signals);
    const told = JSON.stringify([bodies, signals, this.wide]);
    if (told === this.scheme.getAttribute("data-told")) return;
    this.scheme.setAttribute("data-told", told);
    const columns = Math.max(Math.floor(this.wide / 150), 1);
    const rows = Math.ceil(signals.length / columns);
    const height = bodies.length * 34 + rows * 22 + 12;
    this.scheme.setAttribute("width", String(this.wide));
    this.scheme.setAttribute("height", String(height));
    const found: SVGElement[] = [];
    bodies.forEach(([name, at], k) => {
      const places = this.job?.planned[name] ?? [0, 1];
      const [low, high] = [Math.min(...places), Math.max(...places)];
      const where = at.load ?? at.measured ?? at.commanded ?? low;
      const share = Math.min(Math.max((where - low) / Math.max(high - low, 1e-6), 0), 1);
      const [y, wide] = [k * 34 + 6, this.wide - LEFT - 90];
      const x = LEFT + share * (wide - 12);
      found.push(part("text", { x: 4, y: y + 16 }, `${name} ${shown(where * 1000)} mm`));
      found.push(part("rect", { x: LEFT, y, width: wide, height: 22, class: "cylinder" }));
      found.push(
        part("rect", { x, y: y + 9, width: Math.max(LEFT + wide + 60 - x, 4), height: 4, class: "rod" }),
      );
      found.push(part("rect", { x, y, width: 12, height: 22, class: "piston" }));
    });
    signals.forEach(([name, on], k) => {
      const [x, y] = [(k % columns) * 150 + 4, bodies.length * 34 + Math.floor(k / columns) * 22 + 14];
      found.push(part("circle", { cx: x + 6, cy: y, r: 6, class: on ? "lamp on" : "lamp" }));
      found.push(part("text", { x: x + 17, y: y + 4 }, `${name.replaceAll("_", " ")}${on ? "" : " off"}`));
    });
    this.scheme.replaceChildren(...found);
  }
}
