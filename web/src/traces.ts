/** Stored runs in a table: their curves, one beside another, and the recording as a file. */

import uPlot from "uplot";
import { axisOf, CLOSEST, themed } from "./curves";
import { by, made, put, tell, value } from "./dom";
import type { State } from "./messages";
import { pictured, pictureOf, type Trace } from "./run_picture";
import type { Session } from "./session";
import { endOf, unitOf } from "./session";
import { onTheme } from "./theme";
import { say } from "./toasts";
import { clock, inTrouble } from "./wording";

export interface Kept {
  run: string;
  started: string;
  job: string;
  ended: string;
  text: string;
  verdict: string;
}
const IN_SPEC = "in spec";
const LONG_S = 60; // from here on minutes are easier to read
const BEGUN = new Intl.DateTimeFormat([], { dateStyle: "medium", timeStyle: "short" });
const MOST_PICTURES = 12; // of the latest runs: each is read from its recording

/** Whether a run is one of those that the operator filters by words and verdict. */
export function matches(one: Kept, words: string, only: string): boolean {
  const text = `${one.run} ${one.job} ${one.ended} ${one.text} ${one.verdict}`.toLowerCase();
  const good = one.verdict === IN_SPEC;
  const kind = only === "" || (only === IN_SPEC ? good : !good);
  return (
    kind &&
    words
      .toLowerCase()
      .split(/\s+/)
      .every((word) => text.includes(word))
  );
}

/** The time of a trace over which its program ran: "12.3 s"; empty if it is not known. */
function lasted(trace: Pick<Trace, "times_s">): string {
  const last = trace.times_s[trace.times_s.length - 1];
  return last === undefined ? "" : last < LONG_S ? `${last.toFixed(1)} s` : clock(last);
}

export class Traces {
  private readonly traces = new Map<string, Trace>();
  private readonly seen = new Map<string, { lasted: string; picture: ReturnType<typeof pictured> }>();
  private reads = false; // whether pictures are being read
  private plots: uPlot[] = [];
  private last = "";
  private runs: Kept[] = [];
  private run = ""; // the chosen run

  constructor(private readonly session: Session) {
    by<HTMLSelectElement>("trace-axis").onchange = () => this.draw();
    by<HTMLSelectElement>("beside").onchange = () => void this.load();
    by<HTMLInputElement>("run-filter").oninput = () => this.table();
    by<HTMLSelectElement>("run-only").onchange = () => this.table();
    new ResizeObserver(() => {
      const width = this.wide();
      for (const plot of this.plots) if (plot.width !== width) plot.setSize({ width, height: plot.height });
    }).observe(by("review"));
    by("export").onclick = () => void this.save(`recording.${value("export-as")}`);
    by("report").onclick = () => void this.report();
    onTheme(() => this.draw());
  }

  /** The chosen run; null for none. */
  get chosen(): Kept | null {
    return this.runs.find((one) => one.run === this.run) ?? null;
  }

  /** Load the open list again, after a run ended or was judged. */
  show(state: State): void {
    const last = JSON.stringify([state.progress?.run, state.progress?.ended, state.progress?.verdict]);
    if (last === this.last) return;
    this.last = last;
    if (!by("review").hidden) void this.list();
  }

  async list(): Promise<void> {
    const answer = await this.session.ask("/api/runs");
    if (!answer.ok) {
      say((await answer.text()).trim(), true);
      return;
    }
    const newest = this.runs[0]?.run;
    this.runs = (await answer.json()) as Kept[];
    const there = this.runs.some((one) => one.run === this.run);
    if (!there || (newest !== undefined && this.runs[0]?.run !== newest)) this.run = this.runs[0]?.run ?? "";
    this.table();
    this.offerBeside();
    for (const id of ["export", "report"]) put(by<HTMLButtonElement>(id), "disabled", this.runs.length === 0);
    if (this.run) await this.load();
    await this.readPictures();
  }

  /** Read the latest runs, one after the other, for duration and picture; not while the machine moves. */
  private async readPictures(): Promise<void> {
    if (this.reads) return;
    this.reads = true;
    for (const { run } of this.runs.slice(0, MOST_PICTURES)) {
      if (by("review").hidden || this.session.machineMoves()) break;
      if (this.seen.has(run)) continue;
      const answer = await this.session.ask(`/api/runs/${encodeURIComponent(run)}/trace`);
      if (answer.ok) this.remember(run, (await answer.json()) as Trace);
      else this.seen.set(run, { lasted: "", picture: null }); // it has nothing to show
      this.table();
    }
    this.reads = false;
  }

  private remember(run: string, trace: Trace): void {
    this.seen.set(run, { lasted: lasted(trace), picture: pictured(trace) });
  }

  private table(): void {
    const found = this.runs.filter((one) => matches(one, value("run-filter"), value("run-only")));
    tell(
      "run-count",
      found.length === this.runs.length
        ? `${found.length} run${found.length === 1 ? "" : "s"}`
        : `${found.length} of ${this.runs.length} runs`,
    );
    const table = made("table");
    const head = made("thead");
    const names = made("tr");
    for (const name of ["Run", "Begun", "Duration", "End", "Verdict"]) {
      const cell = made("th", name);
      cell.scope = "col";
      names.append(cell);
    }
    head.append(names);
    const body = made("tbody");
    body.append(...found.map((one) => this.row(one)));
    table.append(head, body);
    const kept = by("kept");
    const focused = kept.contains(document.activeElement) ? document.activeElement!.id : "";
    kept.replaceChildren(found.length ? table : made("p", "no run is stored, or none has these words"));
    if (focused) document.getElementById(focused)?.focus({ preventScroll: true }); // it is written anew
  }

  private row(one: Kept): HTMLTableRowElement {
    const row = made("tr");
    if (one.run === this.run) row.setAttribute("aria-current", "true");
    const choose = made("button", one.job || one.run);
    choose.type = "button";
    choose.id = `run-${one.run}`;
    choose.className = "link";
    choose.title = one.run;
    choose.onclick = () => {
      this.run = one.run;
      this.table();
      this.offerBeside();
      void this.load();
    };
    const name = made("th");
    name.scope = "row";
    const known = this.seen.get(one.run);
    name.append(pictureOf(known?.picture), choose);
    const verdict = made("td", one.verdict === one.ended ? "" : one.verdict);
    if (inTrouble(one)) verdict.className = "wrong";
    const begun = new Date(one.started);
    const when = Number.isNaN(begun.getTime()) ? one.started : BEGUN.format(begun);
    const time = made("td", known?.lasted ?? "");
    time.className = "amount";
    const end = made("td", endOf(one.ended, one.text));
    if (one.ended === "fault") end.className = "wrong";
    row.append(name, made("td", when), time, end, verdict);
    return row;
  }

  private offerBeside(): void {
    const chosen = by<HTMLSelectElement>("beside");
    const before = chosen.value;
    const none = made("option", "no other run");
    none.value = "";
    const others = this.runs.filter((one) => one.run !== this.run);
    const options = others.map((one) => {
      const found = made("option", `${one.job || one.run}, ${one.started}`);
      found.value = one.run;
      return found;
    });
    chosen.replaceChildren(none, ...options);
    chosen.value = others.some((one) => one.run === before) ? before : "";
  }

  /** Read the traces of the chosen run and of the one beside it. */
  private async load(): Promise<void> {
    const wanted = [this.run, value("beside")].filter(Boolean);
    for (const run of wanted) if (!this.traces.has(run) && !(await this.read(run))) return;
    if (wanted[0] !== this.run) return; // another was chosen meanwhile
    for (const known of this.traces.keys())
      if (!wanted.includes(known) && this.traces.size > 4) this.traces.delete(known);
    this.table();
    const chosen = by<HTMLSelectElement>("trace-axis");
    const before = chosen.value;
    const names = Object.keys(this.traces.get(this.run)!.axes);
    chosen.replaceChildren(...names.map((name) => made("option", name)));
    const first = names.find((name) => unitOf(this.session, name)[1] === "mm") ?? names[0] ?? "";
    chosen.value = names.includes(before) ? before : first;
    this.draw();
  }

  private async read(run: string): Promise<boolean> {
    tell("trace-said", "Reading the recording of this run.");
    const answer = await this.session.ask(`/api/runs/${encodeURIComponent(run)}/trace`);
    tell("trace-said", "");
    if (!answer.ok) {
      say((await answer.text()).trim(), true);
      return false;
    }
    const trace = (await answer.json()) as Trace;
    this.traces.set(run, trace);
    this.remember(run, trace);
    return true;
  }

  private wide(): number {
    return Math.max(Math.min(by("trace").clientWidth, window.innerWidth - 48), 240);
  }

  private draw(): void {
    for (const plot of this.plots) plot.destroy();
    this.plots = [];
    const own = this.curve(this.run);
    if (!own) return;
    const other = this.curve(value("beside"));
    const unit = unitOf(this.session, value("trace-axis"))[1];
    const tables = [own, ...(other ? [other] : [])];
    const joined = (columns: (one: Columns) => number[][]): uPlot.AlignedData =>
      uPlot.join(tables.map((one) => [one.times, ...columns(one)] as uPlot.AlignedData));
    const line = (label: string, ink: string, dash?: number[]): uPlot.Series => ({
      label,
      stroke: themed(ink),
      ...(dash ? { dash } : {}),
      spanGaps: true,
    });
    const measured = tables.every((one) => one.measured);
    const actual = (label: string, ink: string) => (measured ? [line(label, ink)] : []);
    const both = [line("commanded", "--done", [4, 3]), ...actual("actual", "--measured")];
    const beside = [line("commanded, other run", "--edge", [2, 3]), ...actual("actual, other run", "--ink")];
    const positions = [{}, ...both, ...(other ? beside : [])];
    tell("trace-said", measured ? "" : "Nothing was measured: the curve is what the controller reported.");
    const differences = [
      {},
      line("actual minus commanded", "--measured"),
      ...(other ? [line("the same, other run", "--ink")] : []),
    ];
    const width = this.wide();
    const x = { time: false };
    const more = { width, legend: { live: false }, axes: [axisOf("s"), axisOf(unit, 60)] };
    this.plots = [
      new uPlot(
        { ...more, height: 260, scales: { x }, series: positions },
        joined((one) => (measured ? [one.commanded, one.actual] : [one.commanded])),
        by("trace"),
      ),
    ];
    if (!measured) return; // without a measurement the difference would be 0, as in a perfect run
    this.plots.push(
      new uPlot(
        { ...more, height: 200, scales: { x, y: { range: CLOSEST } }, series: differences },
        joined((one) => [one.difference]),
        by("trace"),
      ),
    );
  }

  /** The columns of a run for the chosen axis, in the units of the page; null without. */
  private curve(run: string): Columns | null {
    const trace = this.traces.get(run);
    const axis = trace?.axes[value("trace-axis")];
    if (!trace || !axis) return null;
    const [scale] = unitOf(this.session, value("trace-axis"));
    const commanded = axis.commanded.map((at) => at * scale);
    const actual = axis.actual.map((at) => at * scale);
    const difference = actual.map((at, k) => at - commanded[k]!);
    return { times: trace.times_s, commanded, actual, difference, measured: axis.measured };
  }

  /** Judge the chosen run again and save its report, which takes a while. */
  private async report(): Promise<void> {
    const button = by<HTMLButtonElement>("report");
    put(button, "disabled", true);
    tell("trace-said", "Judging the run and drawing its report.");
    await this.save("report.pdf");
    tell("trace-said", "");
    put(button, "disabled", this.runs.length === 0);
  }

  /** Save a file that the panel makes of the chosen run. */
  private async save(name: string): Promise<void> {
    const run = this.run;
    const answer = await this.session.ask(`/api/runs/${encodeURIComponent(run)}/${name}`);
    if (!answer.ok) {
      say((await answer.text()).trim(), true);
      return;
    }
    const to = made("a");
    to.href = URL.createObjectURL(await answer.blob());
    to.download = `${run}.${name.split(".").pop()}`;
    to.click();
    URL.revokeObjectURL(to.href);
  }
}

interface Columns {
  times: number[];
  commanded: number[];
  actual: number[];
  difference: number[];
  measured: boolean;
}
