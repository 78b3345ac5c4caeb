/** Curves of an axis: planned, commanded and measured position, and below them measured minus commanded. */

import uPlot from "uplot";
import "uplot/dist/uPlot.min.css";
import { put } from "./dom";
import type { Figures, State } from "./messages";
import { colour, onTheme } from "./theme";
import { onScreen } from "./visibility";

const SHOWN_S = 60;
const MOST = 3000;
const HEIGHT = 170; // of each picture, pixels

/** A colour of the present theme at the time of drawing. */
export const themed = (name: string) => () => colour(name);

/** An axis of a picture, for both themes. */
export function axisOf(label: string, size?: number, space?: number): uPlot.Axis {
  const grid = { stroke: themed("--line"), width: 1 };
  const found: uPlot.Axis = { stroke: themed("--ink"), grid, ticks: grid, label };
  return { ...found, ...(size ? { size } : {}), ...(space ? { space } : {}) };
}

/** Scale of the difference: at least a hundredth of a unit high, since smaller marks would show only rounding. */
export const CLOSEST: uPlot.Scale.Range = (_, low, high) =>
  uPlot.rangeNum(Math.min(low ?? 0, -0.005), Math.max(high ?? 0, 0.005), 0.1, true);

export class Curves {
  private times: number[] = [];
  private commanded: (number | null)[] = [];
  private measured: (number | null)[] = [];
  private due: (number | null)[] = []; // planned position at the run's place in the plan, at each of the times
  private dirty = true;
  private ran = false; // whether a run was going on when the curves were last drawn
  private behind = 0; // delay of the run behind its plan, s: after holds, or a start in the middle
  private planned: [number[], number[]] = [[], []];
  private readonly position: uPlot;
  private readonly deviation: uPlot;
  private readonly seenAbove: () => boolean;
  private readonly seenBelow: () => boolean;

  constructor(
    private readonly above: HTMLElement,
    below: HTMLElement,
  ) {
    const x = { time: false };
    const width = (place: HTMLElement) => Math.max(Math.min(place.clientWidth, window.innerWidth - 48), 240);
    const line = (label: string, ink: string, dash?: number[]): uPlot.Series => ({
      label,
      stroke: themed(ink),
      ...(dash ? { dash } : {}),
    });
    const series = [
      {},
      line("planned", "--planned", [10, 5]),
      line("commanded", "--done", [3, 2]),
      line("measured", "--measured"),
    ];
    const more = { height: HEIGHT, legend: { live: false } };
    this.position = new uPlot(
      { ...more, width: width(above), scales: { x }, axes: [axisOf("s"), axisOf("", 60, 22)], series },
      [[], [], [], []],
      above,
    );
    this.deviation = new uPlot(
      {
        ...more,
        width: width(below),
        scales: { x, y: { range: CLOSEST } },
        axes: [axisOf("s"), axisOf("", 60, 14)], // closer marks, for a low picture
        series: [{}, line("difference", "--measured")],
      },
      [[], []],
      below,
    );
    this.seenAbove = onScreen(above);
    this.seenBelow = onScreen(below);
    new ResizeObserver(() => {
      this.position.setSize({ width: width(above), height: HEIGHT });
      this.deviation.setSize({ width: width(below), height: HEIGHT });
    }).observe(above);
    onTheme(() => {
      this.dirty = true;
    });
  }

  /** Show the plan only, until the machine moves. */
  plan(figures: Figures | null, axis: string, scale: number): void {
    this.clear();
    this.planned = figures?.planned[axis]
      ? [figures.times_s, figures.planned[axis].map((at) => at * scale)]
      : [[], []];
  }

  clear(): void {
    this.dirty = true;
    this.times = [];
    this.commanded = [];
    this.measured = [];
    this.due = [];
    this.behind = 0;
  }

  add(state: State, axis: string, scale: number): void {
    const at = state.axes[axis];
    const last = this.times[this.times.length - 1];
    if (!at || last === state.time_s) return;
    if (last !== undefined && state.time_s < last) this.clear(); // a new motion: its time begins at 0
    this.dirty = true;
    this.times.push(state.time_s);
    this.commanded.push(at.commanded === null ? null : at.commanded * scale);
    const actual = at.measured ?? at.load; // an axis without encoder shows the position of its load
    this.measured.push(actual === null ? null : actual * scale);
    const run = state.progress;
    const runs = run && run.ended === null;
    this.behind = runs ? state.time_s - run.time_s : 0;
    this.due.push(runs ? this.plannedAt(run.time_s) : null);
    if (this.times.length > MOST)
      for (const kept of [this.times, this.commanded, this.measured, this.due]) kept.shift();
  }

  /** Planned position at a time of the plan; null before its start and after its end. */
  private plannedAt(time: number): number | null {
    const [times, places] = this.planned;
    const k = times.findIndex((t) => t >= time);
    if (k < 0) return null;
    const [from, to] = [times[k - 1], times[k]!];
    if (from === undefined) return time < to - 1e-9 ? null : places[k]!;
    return places[k - 1]! + ((places[k]! - places[k - 1]!) * (time - from)) / (to - from);
  }

  draw(running: boolean): void {
    if (!this.dirty && running === this.ran) return;
    const last = this.times.length - 1,
      now = this.times[last] ?? 0,
      behind = this.behind;
    put(
      this.above,
      "title",
      last < 0
        ? ""
        : [
            ["planned", this.due[last]],
            ["commanded", this.commanded[last]],
            ["measured", this.measured[last]],
          ]
            .filter(([, at]) => typeof at === "number")
            .map(([name, at]) => `${name} ${(at as number).toFixed(2)}`)
            .join(", "),
    );
    if (!this.seenAbove() && !this.seenBelow()) return;
    this.dirty = false;
    this.ran = running;
    const from = Math.max(0, now - SHOWN_S),
      until = Math.max(now + 5, from + SHOWN_S),
      first = this.from(from);
    const own = <T>(values: T[]): (T | undefined)[] => values.slice(first);
    const times = this.times.slice(first),
      commanded = own(this.commanded),
      measured = own(this.measured);
    const planned: (number | null | undefined)[] = [];
    // The plan is shifted to the times at which the run reached, or will reach, each place.
    if (running || last < 0) {
      planned.push(...this.due.slice(first));
      this.planned[0].forEach((time, k) => {
        const t = time + behind;
        if (t > until || (last < 0 ? t < from : t <= now)) return;
        times.push(t);
        planned.push(this.planned[1][k]);
      });
    }
    this.above.toggleAttribute("data-empty", times.length === 0);
    const difference = measured.map((m, k) => {
      const c = commanded[k];
      return typeof m !== "number" || typeof c !== "number" ? null : m - c;
    });
    for (const short of [planned, commanded, measured, difference] as unknown[][])
      while (short.length < times.length) short.push(undefined);
    this.position.setData([times, planned, commanded, measured] as uPlot.AlignedData);
    this.deviation.setData([times, difference] as uPlot.AlignedData);
  }

  /** Index of the first kept sample at or after a time. */
  private from(time: number): number {
    const found = this.times.findIndex((t) => t >= time);
    return found < 0 ? this.times.length : found;
  }
}
