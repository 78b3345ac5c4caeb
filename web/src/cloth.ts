/** The cloth from above: stitches by their use of a limit, or in the colours of their threads. */

import { by, made, put } from "./dom";
import type { Progress, State, Stitches } from "./messages";
import type { Picture, Shown } from "./picture";
import { colour, onTheme } from "./theme";
import { onScreen, sizeOf } from "./visibility";
import { before, isOf } from "./wording";
import { Zoom } from "./zoom";

/** Upper ends of the bands of a limit's share, and the colours of the bands. */
const BANDS: [number, string, string][] = [
  [0.5, "--planned", "half of the limit or less"],
  [0.8, "--done", "up to 80 %"],
  [1, "--measured", "up to the limit"],
  [Number.POSITIVE_INFINITY, "--trouble", "beyond it"],
];
const GREYS = ["#4a4a4a", "#7a7a7a", "#262626", "#949494"];
const MARGIN = 18;
const EMPTY = "The stitches of a program are shown here: load one in Prepare.";

type Mark = { x: number; y: number };

/** The band of a used share of a limit. */
export function bandOf(share: number): number {
  return BANDS.findIndex(([most]) => share <= most);
}

/** Stitches a minute about the k-th drawn hole, by the plan; null where it is not known. */
export function pace(
  stitches: Pick<Stitches, "times_s" | "number">,
  k: number,
  percent: number,
): number | null {
  const { times_s, number } = stitches;
  const next = Math.min(Math.max(k + 1, 1), times_s.length - 1);
  const lasts = (times_s[next] ?? 0) - (times_s[next - 1] ?? 0);
  return lasts > 0 ? (0.6 * percent * (number[next]! - number[next - 1]!)) / lasts : null;
}

/** Time of the plan up to which a run has sewn the design, also after it was broken off; null for the whole design. */
export function sewnUntil(
  run: Progress | null,
  job: Pick<Shown, "program" | "times_s"> | null,
): number | null {
  if (!run || !job?.times_s.length || !isOf(job.program, run)) return null;
  return run.ended === null || ["stopped", "fault"].includes(run.ended) ? run.time_s : null;
}

export class Cloth implements Picture {
  readonly element = made("div");
  readonly turns = false;
  private readonly canvas = made("canvas");
  private readonly told = made("p");
  private job: Shown | null = null;
  private done = 0; // number of drawn holes that are sewn
  private sewing = false; // whether a run or a simulation is under way
  private head: Mark | null = null;
  private stands: Mark | null = null; // where the next hold takes effect
  private dirty = true; // all stitches are drawn again; else only the newly sewn ones
  private drawn = 0; // number of holes that are drawn as sewn
  private inks: string[] = []; // colours of the bands or threads; read once, because reading is slow
  private scale = 1; // pixels per metre if the whole work is shown
  private low: Mark = { x: 0, y: 0 }; // corners of the work
  private high: Mark = { x: 0, y: 0 };
  private readonly needle = made("i"); // marks above the stitches: they move, and nothing is drawn again
  private readonly ring = made("i");
  private percent = 100; // feed override of the run
  private readonly seen: () => boolean;
  private readonly part: Zoom; // the visible part of the work

  /** @param recoloured called when the operator chooses other colours */
  constructor(recoloured: () => void) {
    this.told.className = "hint";
    this.canvas.setAttribute("role", "img");
    this.canvas.setAttribute("aria-label", "the cloth from above");
    const sheet = made("div");
    sheet.className = "sheet";
    [this.needle.className, this.ring.className] = ["needle", "ring"];
    sheet.append(this.canvas, this.ring, this.needle);
    this.element.append(this.told, sheet);
    this.seen = onScreen(this.element);
    this.part = new Zoom(this.canvas, () => {
      this.dirty = true;
    });
    onTheme(() => {
      this.dirty = true;
    });
    by("seen-as").onchange = () => {
      this.dirty = true;
      recoloured();
    };
  }

  readonly zoom = (factor: number): void => this.part.by(factor);

  show(job: Shown | null): void {
    if (job?.program !== this.job?.program) this.part.by(0);
    this.job = job;
    this.dirty = true;
    const { x, y } = job?.stitches ?? { x: [0], y: [0] };
    [this.low, this.high] = [smallest, largest].map((of) => ({ x: of(x), y: of(y) })) as [Mark, Mark];
    this.put(null, null);
    this.tell();
    put(by("seen-as"), "hidden", !this.choosable());
  }

  /** Whether a design has threads, and its stitches uses of a limit. */
  private choosable(): boolean {
    const { threads, use } = this.job?.stitches ?? { threads: [], use: [] };
    return threads.length > 0 && use.length > 0;
  }

  private heated(): boolean {
    return this.choosable() && by<HTMLSelectElement>("seen-as").value === "use";
  }

  live(state: State): void {
    const [x, y] = ["X", "Y"].map((name) => state.axes[name]);
    const place = (at: typeof x) => at?.measured ?? at?.load ?? at?.commanded ?? null;
    const [px, py] = [place(x), place(y)];
    const head = px === null || py === null ? null : { x: px, y: py };
    const run = state.progress;
    const runs = run && run.ended === null;
    this.percent = state.feed_percent;
    this.stand(runs && run.hold === "at a rest" ? run.hold_at_s : null);
    this.put(sewnUntil(run, this.job), head);
  }

  /** Mark the place of the next hold, if it waits for a rest. */
  private stand(time_s: number | null): void {
    const at = time_s === null ? null : this.planned(time_s);
    if (at?.x === this.stands?.x && at?.y === this.stands?.y) return;
    this.stands = at;
  }

  private planned(time_s: number): Mark | null {
    const k = Math.max(before(this.job?.times_s ?? [], time_s), 0);
    const [x, y] = [this.job?.planned.X?.[k], this.job?.planned.Y?.[k]];
    return x === undefined || y === undefined ? null : { x, y };
  }

  at(time_s: number): void {
    this.put(time_s, this.planned(time_s));
  }

  /** Show what is sewn at a time, everything without one, and the needle. */
  private put(time_s: number | null, head: Mark | null): void {
    const times = this.job?.stitches?.times_s ?? [];
    const all = this.job?.stitches?.x.length ?? 0;
    const done = time_s === null ? all : before(times, time_s) + 1;
    const sewing = time_s !== null;
    const same =
      sewing === this.sewing && done === this.done && head?.x === this.head?.x && head?.y === this.head?.y;
    if (same) return;
    if (done < this.drawn) this.dirty = true;
    [this.done, this.head, this.sewing] = [done, head, sewing];
    this.tell();
  }

  private tell(): void {
    const stitches = this.job?.stitches;
    this.canvas.setAttribute("aria-label", stitches ? "the cloth from above" : EMPTY);
    if (!stitches) {
      if (this.told.textContent) this.told.textContent = "";
      return;
    }
    const number = this.done ? stitches.number[this.done - 1]! : 0;
    const block = stitches.threads.length > 1 ? this.thread(Math.max(this.done - 1, 0)) : "";
    const fast = pace(stitches, this.done - 1, this.percent);
    const speed = fast === null ? "" : `, ${fast.toFixed(0)} stitches a minute`;
    const text = this.sewing
      ? `stitch ${number} of ${stitches.count}${block}${speed}`
      : `${stitches.count} stitches`;
    if (this.told.textContent !== text) this.told.textContent = text;
  }

  private thread(k: number): string {
    const { block, threads } = this.job!.stitches!;
    return `, thread ${block[k]} of ${threads.length}`;
  }

  private inThreads(): boolean {
    return (this.job?.stitches?.threads.length ?? 0) > 0 && !this.heated();
  }

  private colourOf(k: number): string {
    const { block, threads, use } = this.job!.stitches!;
    if (this.inThreads()) return threads[block[k]! - 1] ?? GREYS[(block[k]! - 1) % GREYS.length]!;
    return this.inks[use.length ? bandOf(use[k]!) : BANDS.length]!;
  }

  legend(): [string, string][] {
    const stitches = this.job?.stitches;
    if (!stitches) return [];
    if (this.inThreads()) {
      const known = stitches.threads.map((one, k): [string, string] => [
        one ?? GREYS[k % GREYS.length]!,
        one ? `thread ${k + 1}` : `thread ${k + 1}: the file has no colour`,
      ]);
      return known;
    }
    if (!stitches.use.length) return [];
    return BANDS.map(([, name, text], k) => [`var(${name})`, k ? text : `${stitches.use_of}: ${text}`]);
  }

  resize(): void {
    const [width, height] = sizeOf(this.element);
    const sharp = window.devicePixelRatio || 1;
    if (this.canvas.width === width * sharp && this.canvas.height === height * sharp) return;
    [this.canvas.width, this.canvas.height] = [width * sharp, height * sharp];
    this.canvas.style.width = `${width}px`;
    this.canvas.style.height = `${height}px`;
    this.dirty = true;
  }

  draw(): void {
    if (!this.seen()) return;
    const stitches = this.job?.stitches;
    const has = !!stitches?.x.length;
    if (this.dirty) this.anew(has);
    else if (has && this.done > this.drawn) this.sew(this.drawn, this.done);
    this.drawn = this.done;
    this.mark(this.ring, has ? this.stands : null);
    this.mark(this.needle, has ? this.head : null);
  }

  /** Draw the cloth and all stitches. */
  private anew(has: boolean): void {
    this.dirty = false;
    const pen = this.canvas.getContext("2d")!;
    const { width, height } = this.canvas;
    pen.clearRect(0, 0, width, height);
    if (!has) {
      this.nothing(pen);
      return;
    }
    const threads = this.inThreads();
    if (threads) {
      pen.fillStyle = colour("--cloth");
      pen.fillRect(0, 0, width, height);
    }
    put(this.needle, "className", threads ? "needle on-cloth" : "needle");
    this.inks = [...BANDS.map(([, name]) => colour(name)), colour("--done")];
    const [wide, tall] = [this.high.x - this.low.x, this.high.y - this.low.y].map((one) =>
      Math.max(one, 1e-4),
    );
    const space = MARGIN * this.sharp;
    this.scale = Math.min((width - 2 * space) / wide!, (height - 2 * space) / tall!);
    this.sew(0, this.job!.stitches!.x.length);
  }

  private get sharp(): number {
    return window.devicePixelRatio || 1;
  }

  /** Where a place of the cloth is in the picture, pixels. */
  private x(at: number): number {
    const { width } = this.canvas;
    const middle = (this.low.x + this.high.x) / 2;
    return this.part.seen(width / 2 + (at - middle) * this.scale, width, "x");
  }

  private y(at: number): number {
    const { height } = this.canvas;
    const middle = (this.low.y + this.high.y) / 2;
    return this.part.seen(height / 2 - (at - middle) * this.scale, height, "y");
  }

  /** Draw the stitches from one hole up to another. */
  private sew(from: number, to: number): void {
    const pen = this.canvas.getContext("2d")!;
    const { x, y, joined } = this.job!.stitches!;
    const { sharp } = this;
    const threads = this.inThreads();
    const size = Math.max(1.5, Math.min(4, this.scale * this.part.factor * 4e-4)) * sharp;
    for (let k = from; k < to; k++) {
      const sewn = k < this.done;
      pen.globalAlpha = sewn ? 1 : 0.35;
      pen.strokeStyle = pen.fillStyle = this.colourOf(k);
      pen.lineWidth = (sewn && threads ? 2.2 : sewn ? 1.6 : 1) * sharp;
      if (k && joined[k]) {
        pen.beginPath();
        pen.moveTo(this.x(x[k - 1]!), this.y(y[k - 1]!));
        pen.lineTo(this.x(x[k]!), this.y(y[k]!));
        pen.stroke();
      }
      pen.beginPath();
      pen.arc(this.x(x[k]!), this.y(y[k]!), size, 0, 2 * Math.PI);
      pen.fill();
    }
    pen.globalAlpha = 1;
  }

  /** Put a mark on a place of the cloth; hide it without one. */
  private mark(one: HTMLElement, at: Mark | null): void {
    put(one, "hidden", at === null);
    if (at === null) return;
    const moved = `translate(${Math.round(this.x(at.x) / this.sharp)}px, ${Math.round(this.y(at.y) / this.sharp)}px)`;
    if (one.style.transform !== moved) one.style.transform = moved;
  }

  /** Say why nothing is drawn, and what to do. */
  private nothing(pen: CanvasRenderingContext2D): void {
    const sharp = window.devicePixelRatio || 1;
    pen.fillStyle = colour("--faint");
    pen.font = `${14 * sharp}px system-ui, sans-serif`;
    pen.textAlign = "center";
    pen.fillText(EMPTY, this.canvas.width / 2, this.canvas.height / 2);
  }
}

function smallest(all: number[]): number {
  return all.reduce((least, one) => Math.min(least, one), all[0] ?? 0);
}

function largest(all: number[]): number {
  return all.reduce((most, one) => Math.max(most, one), all[0] ?? 0);
}
