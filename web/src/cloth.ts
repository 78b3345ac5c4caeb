/** The cloth from above: stitches by their use of a limit, or in the colours of their threads. */

import { made } from "./dom";
import type { State } from "./messages";
import { colour, onTheme } from "./theme";
import type { Picture, Shown } from "./view";
import { onScreen, sizeOf } from "./visibility";
import { before } from "./wording";

/** Upper ends of the shares of a limit, and the colours of what lies below them. */
const BANDS: [number, string, string][] = [
  [0.5, "--planned", "half of the limit or less"],
  [0.8, "--done", "up to 80 %"],
  [1, "--measured", "up to the limit"],
  [Number.POSITIVE_INFINITY, "--trouble", "beyond it"],
];
const GREYS = ["#555555", "#8a8a8a", "#333333", "#a5a5a5"];
const MARGIN = 18;

type Mark = { x: number; y: number };

/** The band of a used share of a limit. */
export function bandOf(share: number): number {
  return BANDS.findIndex(([most]) => share <= most);
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
  private dirty = true;
  private readonly seen: () => boolean;

  constructor() {
    this.told.className = "hint";
    this.canvas.setAttribute("role", "img");
    this.element.append(this.told, this.canvas);
    this.seen = onScreen(this.element);
    onTheme(() => {
      this.dirty = true;
    });
  }

  show(job: Shown | null): void {
    this.job = job;
    this.dirty = true;
    this.put(null, null);
    this.tell();
  }

  live(state: State): void {
    const [x, y] = ["X", "Y"].map((name) => state.axes[name]);
    const place = (at: typeof x) => at?.measured ?? at?.load ?? at?.commanded ?? null;
    const [px, py] = [place(x), place(y)];
    const head = px === null || py === null ? null : { x: px, y: py };
    const run = state.progress;
    this.put(run && run.ended === null ? run.time_s : null, head);
  }

  at(time_s: number): void {
    const k = Math.max(before(this.job?.times_s ?? [], time_s), 0);
    const [x, y] = [this.job?.planned.X?.[k], this.job?.planned.Y?.[k]];
    this.put(time_s, x === undefined || y === undefined ? null : { x, y });
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
    [this.done, this.head, this.dirty, this.sewing] = [done, head, true, sewing];
    this.tell();
  }

  private tell(): void {
    const stitches = this.job?.stitches;
    if (!stitches) return;
    const number = this.done ? stitches.number[this.done - 1]! : 0;
    const block = stitches.threads.length > 1 ? this.thread(Math.max(this.done - 1, 0)) : "";
    const text = this.sewing ? `stitch ${number} of ${stitches.count}${block}` : `${stitches.count} stitches`;
    if (this.told.textContent !== text) this.told.textContent = text;
    if (this.canvas.getAttribute("aria-label") !== "the cloth from above")
      this.canvas.setAttribute("aria-label", "the cloth from above");
  }

  private thread(k: number): string {
    const { block, threads } = this.job!.stitches!;
    return `, thread ${block[k]} of ${threads.length}`;
  }

  private inThreads(): boolean {
    return (this.job?.stitches?.threads.length ?? 0) > 0;
  }

  private colourOf(k: number): string {
    const { block, threads, use } = this.job!.stitches!;
    if (this.inThreads()) return threads[block[k]! - 1] ?? GREYS[(block[k]! - 1) % GREYS.length]!;
    return use.length ? colour(BANDS[bandOf(use[k]!)]![1]) : colour("--done");
  }

  legend(): [string, string][] {
    const stitches = this.job?.stitches;
    if (!stitches) return [];
    if (this.inThreads()) {
      const known = stitches.threads.map((one, k): [string, string] => [
        one ?? GREYS[k % GREYS.length]!,
        one ? `thread ${k + 1}` : `thread ${k + 1}: the file has no colour`,
      ]);
      return stitches.use.length
        ? [...known, ["var(--trouble)", `${stitches.use_of} near its limit`]]
        : known;
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
    if (!this.dirty || !this.seen()) return;
    this.dirty = false;
    const pen = this.canvas.getContext("2d")!;
    const stitches = this.job?.stitches;
    pen.clearRect(0, 0, this.canvas.width, this.canvas.height);
    if (!stitches?.x.length) return;
    const sharp = window.devicePixelRatio || 1;
    const [low, high] = [
      [Math.min(...stitches.x), Math.min(...stitches.y)],
      [Math.max(...stitches.x), Math.max(...stitches.y)],
    ];
    const [wide, tall] = [Math.max(high[0]! - low[0]!, 1e-4), Math.max(high[1]! - low[1]!, 1e-4)];
    const space = MARGIN * sharp;
    const scale = Math.min((this.canvas.width - 2 * space) / wide, (this.canvas.height - 2 * space) / tall);
    const x = (at: number) => (this.canvas.width - wide * scale) / 2 + (at - low[0]!) * scale;
    const y = (at: number) => (this.canvas.height + tall * scale) / 2 - (at - low[1]!) * scale;
    const size = Math.max(1.5, Math.min(4, scale * 4e-4)) * sharp;
    for (let k = 0; k < stitches.x.length; k++) {
      const sewn = k < this.done;
      pen.globalAlpha = sewn ? 1 : 0.35;
      pen.strokeStyle = pen.fillStyle = this.colourOf(k);
      pen.lineWidth = (sewn && this.inThreads() ? 2.2 : sewn ? 1.6 : 1) * sharp;
      if (k && stitches.joined[k]) {
        pen.beginPath();
        pen.moveTo(x(stitches.x[k - 1]!), y(stitches.y[k - 1]!));
        pen.lineTo(x(stitches.x[k]!), y(stitches.y[k]!));
        pen.stroke();
      }
      const hot = this.inThreads() && (stitches.use[k] ?? 0) > 0.95;
      if (hot) pen.fillStyle = colour("--trouble");
      pen.beginPath();
      pen.arc(x(stitches.x[k]!), y(stitches.y[k]!), hot ? 1.6 * size : size, 0, 2 * Math.PI);
      pen.fill();
    }
    pen.globalAlpha = 1;
    if (this.head) this.cross(pen, x(this.head.x), y(this.head.y), 9 * sharp);
  }

  /** A cross where the needle is. */
  private cross(pen: CanvasRenderingContext2D, x: number, y: number, size: number): void {
    pen.strokeStyle = colour("--ink");
    pen.lineWidth = 2;
    pen.beginPath();
    for (const [dx, dy] of [
      [size, 0],
      [0, size],
    ] as [number, number][]) {
      pen.moveTo(x - dx, y - dy);
      pen.lineTo(x + dx, y + dy);
    }
    pen.stroke();
  }
}
