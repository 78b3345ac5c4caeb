/** A cycle of cylinders: its steps, a schematic of cylinders and contacts, and a timing diagram. */

import { change, made } from "./dom";
import type { Lane, State } from "./messages";
import type { Picture, Shown } from "./picture";
import { type Parts, part, Scheme, spoken, type Told, toldBy } from "./scheme";
import { onScreen, sizeOf } from "./visibility";
import { before } from "./wording";

const ROW = 18;
const LABEL_ROW = 15;
const LABEL_ROWS = 3; // in which the names of short steps stand below each other
const LETTER = 7;
const LEFT = 110;
const CURVE = 54;

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

/** Add a state of a lane at a time to the spans in which it was on. */
export function extend(found: [number, number][], time_s: number, on: boolean): void {
  const last = found[found.length - 1];
  const open = last !== undefined && last[1] === Number.POSITIVE_INFINITY;
  if (on && !open) found.push([time_s, Number.POSITIVE_INFINITY]);
  else if (!on && open) last[1] = time_s;
}

/** The row of each name, so that names from their places on stand beside each other: the first free row. */
export function rowsOf(names: string[], places: number[], rows = LABEL_ROWS): number[] {
  const ends = new Array<number>(rows).fill(Number.NEGATIVE_INFINITY);
  return names.map((name, k) => {
    const free = ends.findIndex((end) => end <= places[k]!);
    const row = free < 0 ? ends.indexOf(Math.min(...ends)) : free;
    ends[row] = places[k]! + name.length * LETTER + 6;
    return row;
  });
}

/** Whether a lane is on at a time of the plan. */
export function isOn(lane: Lane, time_s: number): boolean {
  return lane.on !== (lane.changes_s.filter((one) => one <= time_s).length % 2 === 1);
}

/** What the schematic shows of a plan at a time. */
export function plannedAt(job: Shown, time_s: number): Told {
  const k = Math.max(before(job.times_s, time_s), 0);
  const at = Object.entries(job.planned).map(([name, places]): [string, number] => [name, places[k] ?? 0]);
  const on = job.lanes.map((lane): [string, boolean] => [lane.name, isOn(lane, time_s)]);
  return { at: Object.fromEntries(at), on: Object.fromEntries(on), homed: true };
}

export class Steps implements Picture {
  readonly element = made("div");
  readonly turns = false;
  private readonly list = made("ol");
  private readonly scheme: Scheme;
  private readonly diagram = part("svg", { role: "img", "aria-label": "timing diagram" });
  private job: Shown | null = null;
  private time_s: number | null = null;
  private actual: Record<string, [number, number][]> = {}; // time and position, of the run under way
  private run = "";
  private switched: Record<string, [number, number][]> = {}; // spans in which each lane was on
  private told: Told = { at: {}, on: {}, homed: false }; // what the schematic shows
  private ranges: Record<string, [number, number]> = {}; // of the planned positions of each axis
  private head = 0; // height of the names of the steps, pixels
  private until_s = 0; // how far the run has come
  private dirty = true;
  private wide = 0; // of the diagram, pixels; asked for once, because each question lays the page out
  private readonly seen: () => boolean;

  constructor(parts: Parts) {
    this.scheme = new Scheme(parts);
    this.element.className = "steps";
    this.list.setAttribute("aria-label", "Steps of the cycle");
    this.element.append(this.list, this.scheme.element, this.diagram);
    this.seen = onScreen(this.element);
  }

  show(job: Shown | null): void {
    const again = job !== null && job.proof !== "" && job.proof === this.job?.proof; // after a reconnection
    this.job = job;
    this.time_s = null;
    if (!again) [this.actual, this.switched] = [{}, {}];
    this.list.replaceChildren(...(job?.steps ?? []).map((one) => made("li", one.name)));
    this.lay();
    this.dirty = true;
  }

  live(state: State): void {
    const told = toldBy(state);
    const run = state.progress;
    if (JSON.stringify(told) !== JSON.stringify(this.told)) this.dirty = true;
    this.told = told;
    if (run && run.run !== this.run) {
      [this.run, this.actual, this.switched] = [run.run, {}, {}];
      this.lay();
    }
    const runs = run && run.ended === null;
    const time_s = runs ? run.time_s : null;
    if (time_s !== this.time_s) [this.time_s, this.dirty] = [time_s, true];
    if (runs) this.until_s = run.time_s;
    if (runs)
      for (const [name, at] of Object.entries(state.axes)) {
        const where = at.load ?? at.measured ?? at.commanded;
        const kept = this.actual[name] ?? [];
        this.actual[name] = kept;
        const last = kept[kept.length - 1];
        if (where !== null && (!last || run.time_s > last[0])) kept.push([run.time_s, where]);
      }
    if (runs)
      for (const [name, on] of Object.entries(state.signals))
        extend(this.spansOf(name), run.time_s, on !== 0);
  }

  private spansOf(name: string): [number, number][] {
    const found = this.switched[name] ?? [];
    this.switched[name] = found;
    return found;
  }

  at(time_s: number): void {
    this.time_s = Math.min(time_s, this.job?.duration_s ?? 0);
    if (this.job) this.told = plannedAt(this.job, this.time_s);
    this.dirty = true;
  }

  legend(): [string, string][] {
    if (!this.job?.duration_s) return [];
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
    if (!this.dirty || !this.seen()) return;
    this.dirty = false;
    this.scheme.draw(this.told);
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
      if ((k === now) === one.hasAttribute("aria-current")) return;
      if (k === now) one.setAttribute("aria-current", "step");
      else one.removeAttribute("aria-current");
    });
    this.drawNow();
  }

  // --- the diagram ----------------------------------------------------------------------------

  private x(time_s: number): number {
    return LEFT + ((this.wide - LEFT - 12) * time_s) / Math.max(this.job?.duration_s ?? 1, 1e-3);
  }

  /** Lay out what does not change in a run: the steps, planned positions and lanes. */
  private lay(): void {
    const job = this.job;
    this.wide = sizeOf(this.element)[0];
    this.scheme.resize(this.wide);
    this.diagram.replaceChildren();
    if (!job || job.duration_s === 0) {
      this.diagram.setAttribute("height", "0");
      return;
    }
    const axes = Object.entries(job.planned);
    this.ranges = Object.fromEntries(
      axes.map(([name, places]) => [name, [Math.min(...places), Math.max(...places)]]),
    );
    const lanes = job.lanes.filter((one) => one.changes_s.length);
    const begins = job.steps.map((one) => this.x(one.begin_s));
    const rows = rowsOf(
      job.steps.map((one) => one.name),
      begins,
    );
    this.head = 8 + LABEL_ROW * (Math.max(...rows, 0) + 1);
    const height = this.head + axes.length * CURVE + lanes.length * ROW + 8;
    this.diagram.setAttribute("width", String(this.wide));
    this.diagram.setAttribute("height", String(height));
    for (const one of job.steps) {
      const x = this.x(one.begin_s);
      this.diagram.append(part("line", { x1: x, x2: x, y1: 0, y2: height, class: "grid" }));
    }
    job.steps.forEach((one, k) => {
      const next = rows.findIndex((row, n) => n > k && row === rows[k]);
      const room = Math.floor(((next < 0 ? this.wide : begins[next]!) - begins[k]! - 3) / LETTER);
      const text = one.name.length <= room ? one.name : `${one.name.slice(0, Math.max(room - 1, 0))}…`;
      const name = part("text", { x: begins[k]! + 3, y: 14 + LABEL_ROW * rows[k]! }, text);
      name.append(part("title", {}, one.name));
      this.diagram.append(name);
    });
    axes.forEach(([name, places], k) => {
      const line = places
        .map((at, n) => `${this.x(job.times_s[n]!).toFixed(1)},${this.y(name, at, k)}`)
        .join(" ");
      this.diagram.append(part("text", { x: 4, y: this.head + k * CURVE + CURVE / 2 }, `${name}, mm`));
      this.diagram.append(part("polyline", { points: line, class: "planned" }));
      this.diagram.append(part("g", { "data-axis": name }));
    });
    lanes.forEach((lane, k) => {
      const y = this.head + axes.length * CURVE + k * ROW;
      this.diagram.append(part("text", { x: 4, y: y + 13 }, spoken(lane.name)));
      for (const [from, until] of spans(lane.on, lane.changes_s, job.duration_s))
        this.diagram.append(
          part("rect", {
            x: this.x(from),
            y: y + 3,
            width: Math.max(this.x(until) - this.x(from), 1),
            height: 6,
            class: lane.input ? "contact" : "output",
          }),
        );
      this.diagram.append(
        part("path", { d: "", class: "switched", "data-lane": lane.name, "data-y": y + 12 }),
      );
    });
    this.diagram.append(part("line", { x1: 0, x2: 0, y1: 0, y2: height, class: "now" }));
  }

  private y(name: string, at: number, k: number): string {
    const [low, high] = this.ranges[name] ?? [0, 1];
    return (
      this.head +
      (k + 1) * CURVE -
      6 -
      ((CURVE - 14) * (at - low)) / Math.max(high - low, 1e-6)
    ).toFixed(1);
  }

  private drawNow(): void {
    const line = this.diagram.querySelector(".now");
    if (!line) return;
    const x = (this.time_s === null ? -1 : this.x(this.time_s)).toFixed(1);
    change(line, "x1", x);
    change(line, "x2", x);
    Object.keys(this.job!.planned).forEach((name, k) => {
      const drawn = this.diagram.querySelector(`[data-axis="${name}"]`);
      const points = (this.actual[name] ?? []).map((one): [number, number] => [
        this.x(one[0]),
        Number(this.y(name, one[1], k)),
      ]);
      if (drawn) drawPieces(drawn, pieces(thinned(points)));
    });
    for (const drawn of this.diagram.querySelectorAll("[data-lane]")) {
      const y = drawn.getAttribute("data-y");
      const found = this.switched[drawn.getAttribute("data-lane")!] ?? [];
      const now = this.until_s; // what is on goes on up to here
      const ways = found.map(([from, to]) => {
        const until = Math.max(this.x(Math.min(to, now)), this.x(from) + 1);
        return `M${this.x(from).toFixed(1)} ${y}H${until.toFixed(0)}`;
      });
      change(drawn, "d", ways.join(""));
    }
  }
}

const PIECE = 24; // points

/** Points without those that lie on the pixel of the point before them. */
export function thinned(points: [number, number][]): [number, number][] {
  const found: [number, number][] = [];
  for (const one of points) {
    const last = found[found.length - 1];
    if (!last || Math.abs(one[0] - last[0]) >= 1 || Math.abs(one[1] - last[1]) >= 1) found.push(one);
  }
  return found;
}

/** A curve in pieces that meet, so that a new point draws only the last one again. */
export function pieces(points: [number, number][], most = PIECE): string[] {
  const found: string[] = [];
  for (let k = 0; k < Math.max(points.length - 1, 0); k += most)
    found.push(
      points
        .slice(k, k + most + 1)
        .map(([x, y]) => `${x.toFixed(1)},${y.toFixed(1)}`)
        .join(" "),
    );
  return found;
}

function drawPieces(at: Element, lines: string[]): void {
  while (at.children.length > lines.length) at.lastElementChild!.remove();
  lines.forEach((points, k) => {
    const line = at.children[k] ?? at.appendChild(part("polyline", { points: "", class: "actual" }));
    change(line, "points", points);
  });
}
