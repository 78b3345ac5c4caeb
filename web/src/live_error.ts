/** The measured error of a run against its limit band: the largest so far at each place of the plan. */

import { by, made, put, tell } from "./dom";
import type { Figures, LiveContour, State } from "./messages";
import { colour, onTheme } from "./theme";
import { onScreen } from "./visibility";
import { amount, before, isOf } from "./wording";

const TELLS_MS = 250;
const BINS = 400;
const HEIGHT = 96;
const PAD = 14; // pixels above the limit line, for larger errors

/** The largest value in each of a number of equal stretches of a time. */
export class Stretches {
  readonly largest: Float64Array;

  constructor(
    private readonly duration_s: number,
    count = BINS,
  ) {
    this.largest = new Float64Array(count).fill(-1);
  }

  /** Take a value that was the largest between two instants; return whether it is the largest anywhere. */
  add(from_s: number, to_s: number, value: number): boolean {
    let larger = false;
    for (let k = this.of(from_s); k <= this.of(to_s); k++)
      if (value > this.largest[k]!) [this.largest[k], larger] = [value, true];
    return larger;
  }

  of(time_s: number): number {
    const share = time_s / Math.max(this.duration_s, 1e-9);
    return Math.min(Math.max(Math.floor(share * this.largest.length), 0), this.largest.length - 1);
  }
}

/** The line of a plan that is under way at an instant; 0 where none is known. */
export function lineAt(figures: Figures | null, time_s: number): number {
  const at = figures ? before(figures.lines.times_s, time_s) : -1;
  return at < 0 ? 0 : figures!.lines.line[at]!;
}

export class LiveError {
  private readonly canvas = made("canvas");
  private readonly seen: () => boolean;
  private figures: Figures | null = null;
  private run = "";
  private stretches = new Stretches(1);
  private duration_s = 1;
  private limit = 0;
  private worst_s = 0;
  private now_s = 0;
  private dirty = true;
  private told = ""; // the shown words without the present error
  private toldMs = Number.NEGATIVE_INFINITY; // when the words were written

  constructor(private readonly toLine: (line: number) => void) {
    this.canvas.setAttribute("role", "img");
    this.canvas.setAttribute(
      "aria-label",
      "error at each place of the program, its limit band, and the worst place",
    );
    this.canvas.height = HEIGHT;
    by("error-band").append(this.canvas);
    this.seen = onScreen(this.canvas);
    this.canvas.onclick = (event) => {
      const line = lineAt(
        this.figures,
        (this.duration_s * event.offsetX) / Math.max(this.canvas.clientWidth, 1),
      );
      if (line) toLine(line);
    };
    by("error-line").onclick = () => this.toLine(lineAt(this.figures, this.worst_s));
    new ResizeObserver(() => {
      this.dirty = true;
    }).observe(by("error-band"));
    onTheme(() => {
      this.dirty = true;
    });
  }

  /** Take the plan, whose lines a click leads to. */
  show(figures: Figures | null): void {
    this.figures = figures;
  }

  live(state: State): void {
    const run = state.progress;
    const told = run?.contour ?? null;
    put(by("error-live"), "hidden", told === null);
    if (!run || !told) return;
    if (run.run !== this.run) {
      [this.run, this.duration_s, this.now_s] = [run.run, run.duration_s, run.time_s];
      this.stretches = new Stretches(run.duration_s);
      this.dirty = true;
    }
    const going = run.ended === null;
    const more = going && this.stretches.add(this.now_s, run.time_s, told.now_m);
    const worse = this.stretches.add(told.worst_s, told.worst_s, told.worst_m);
    if (more || worse || told.limit_m !== this.limit || told.worst_s !== this.worst_s) this.dirty = true;
    [this.now_s, this.limit, this.worst_s] = [run.time_s, told.limit_m, told.worst_s];
    if (!this.due(told, going)) return;
    const beyond = told.worst_m > told.limit_m;
    const where = told.at === "load" ? "measured at the load" : "measured at the encoders";
    const now = going ? `now ${amount(told.now_m, "m")}, ` : "";
    tell(
      "error-told",
      `${now}so far at most ${amount(told.worst_m, "m")} of ${amount(told.limit_m, "m")}, ${where}`,
    );
    put(by("error-told"), "className", beyond ? "wrong" : "");
    const own = this.figures !== null && isOf(this.figures.program, run);
    const line = own ? lineAt(this.figures, told.worst_s) : 0;
    put(by("error-line"), "hidden", line === 0);
    if (line) tell("error-line", `worst at line ${line}`);
  }

  /** Whether the words about the error are due: four times a second in a run, else at each change. */
  private due(told: LiveContour, going: boolean): boolean {
    const key = `${going} ${told.worst_m} ${told.limit_m} ${told.at}`;
    const now = performance.now();
    if (key === this.told && now - this.toldMs < TELLS_MS) return false;
    [this.told, this.toldMs] = [key, now];
    return true;
  }

  draw(): void {
    if (!this.dirty || !this.seen()) return;
    this.dirty = false;
    const wide = Math.max(by("error-band").clientWidth, 100);
    if (this.canvas.width !== wide) this.canvas.width = wide;
    const pen = this.canvas.getContext("2d")!;
    const { largest } = this.stretches;
    const most = Math.max(this.limit, ...largest) || 1;
    const y = (value: number) => HEIGHT - 2 - ((HEIGHT - 2 - PAD) * value) / most;
    pen.clearRect(0, 0, wide, HEIGHT);
    pen.fillStyle = colour("--line");
    pen.globalAlpha = 0.4;
    pen.fillRect(0, y(this.limit), wide, HEIGHT - y(this.limit));
    pen.globalAlpha = 1;
    const step = wide / largest.length;
    const [within, beyond] = [colour("--done"), colour("--trouble")]; // read once, because reading is slow
    largest.forEach((value, k) => {
      if (value < 0) return;
      pen.fillStyle = value > this.limit ? beyond : within;
      pen.fillRect(k * step, y(value), Math.max(step, 1), HEIGHT - y(value));
    });
    pen.fillStyle = colour("--ink");
    pen.fillRect(0, y(this.limit) - 1, wide, 1);
    pen.font = "12px system-ui, sans-serif";
    const limit = `limit ${amount(this.limit, "m")}`;
    const at = step * (this.stretches.of(this.worst_s) + 0.5);
    pen.textAlign = at < wide / 2 ? "right" : "left"; // beside the mark of the worst place
    pen.fillText(limit, at < wide / 2 ? wide - 4 : 4, y(this.limit) - 3);
    pen.beginPath();
    pen.moveTo(at - 5, 0);
    pen.lineTo(at + 5, 0);
    pen.lineTo(at, 8);
    pen.fill();
  }
}
