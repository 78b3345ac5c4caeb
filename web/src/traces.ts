/** Stored runs: curves of commanded and actual position and their difference; the recording as a file. */

import uPlot from "uplot";
import { by, made, value } from "./dom";
import { BLUE, CLOSEST, INK, ORANGE } from "./curves";
import type { State } from "./messages";
import type { Session } from "./session";
import { endOf, say, unitOf } from "./session";

export interface Kept { run: string; started: string; job: string; ended: string; text: string; verdict: string }
interface Trace { times_s: number[]; axes: Record<string, { commanded: number[]; actual: number[] }> }

export class Traces {
  private trace: Trace | null = null;
  private plots: uPlot[] = [];
  private last = "";
  private runs: Kept[] = [];

  constructor(private readonly session: Session) {
    by<HTMLSelectElement>("kept").onchange = () => void this.load();
    by<HTMLSelectElement>("trace-axis").onchange = () => this.draw();
    new ResizeObserver(() => { const width = this.wide(); for (const plot of this.plots) if (plot.width !== width) plot.setSize({ width, height: plot.height }); }).observe(by("runs"));
    by("export").onclick = () => void this.save();
  }

  /** The chosen run; null for none. */
  get chosen(): Kept | null { return this.runs.find((one) => one.run === value("kept")) ?? null; }

  /** Load the open list again, after a run ended or was judged. */
  show(state: State): void {
    const last = JSON.stringify([state.progress?.run, state.progress?.ended, state.progress?.verdict]);
    if (last === this.last) return;
    this.last = last;
    if (!by("runs").hidden) void this.list();
  }

  async list(): Promise<void> {
    const before = value("kept");
    const answer = await this.session.ask("/api/runs");
    if (!answer.ok) { say((await answer.text()).trim(), true); return; }
    const runs = this.runs = (await answer.json()) as Kept[];
    by("kept").replaceChildren(...runs.map((one) => { const found = made("option", `${one.run}: ${endOf(one.ended, one.text)}${one.verdict === one.ended ? "" : `; ${one.verdict}${one.verdict === "not judged" ? "" : " in this run"}`}`); found.value = one.run; return found; }));
    if (runs.some((one) => one.run === before)) by<HTMLSelectElement>("kept").value = before;
    by<HTMLButtonElement>("export").disabled = runs.length === 0;
    if (runs.length) await this.load();
  }

  private async load(): Promise<void> {
    by("trace-said").textContent = "reading";
    const answer = await this.session.ask(`/api/runs/${encodeURIComponent(value("kept"))}/trace`);
    by("trace-said").textContent = "";
    if (!answer.ok) { say((await answer.text()).trim(), true); return; }
    this.trace = (await answer.json()) as Trace;
    const chosen = by<HTMLSelectElement>("trace-axis"), before = chosen.value, names = Object.keys(this.trace.axes);
    chosen.replaceChildren(...names.map((name) => made("option", name)));
    chosen.value = names.includes(before) ? before : names.find((name) => unitOf(this.session, name)[1] === "mm") ?? names[0] ?? "";
    this.draw();
  }

  private wide(): number { return Math.max(Math.min(by("trace").clientWidth, window.innerWidth - 60), 280); }

  private draw(): void {
    for (const plot of this.plots) plot.destroy();
    const axis = this.trace?.axes[value("trace-axis")];
    if (!this.trace || !axis) return;
    const [scale, unit] = unitOf(this.session, value("trace-axis")), times = this.trace.times_s;
    const commanded = axis.commanded.map((at) => at * scale), actual = axis.actual.map((at) => at * scale);
    const difference = actual.map((at, k) => at - commanded[k]!);
    const width = this.wide(), axes = (label: string) => [{ stroke: INK, label: "s" }, { stroke: INK, size: 60, label }];
    const x = { time: false };
    this.plots = [
      new uPlot({ width, height: 260, legend: { live: false }, scales: { x }, axes: axes(unit), series: [{}, { label: "commanded", stroke: BLUE, dash: [4, 3] }, { label: "actual", stroke: ORANGE }] }, [times, commanded, actual], by("trace")),
      new uPlot({ width, height: 200, legend: { live: false }, scales: { x, y: { range: CLOSEST } }, axes: axes(unit), series: [{}, { label: "actual minus commanded", stroke: ORANGE }] }, [times, difference], by("trace")),
    ];
  }

  private async save(): Promise<void> {
    const run = value("kept"), ending = value("export-as");
    const answer = await this.session.ask(`/api/runs/${encodeURIComponent(run)}/recording.${ending}`);
    if (!answer.ok) { say((await answer.text()).trim(), true); return; }
    const to = made("a");
    to.href = URL.createObjectURL(await answer.blob());
    to.download = `${run}.${ending}`;
    to.click();
    URL.revokeObjectURL(to.href);
  }
}
