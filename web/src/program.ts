/** The part program: load it, calculate it by the operator's priority, show its figures, run it. */

import { asked, button, by, made, put, tell, value } from "./dom";
import type { Criterion, Figures, Proven, State } from "./messages";
import type { Session } from "./session";
import { say, toldRun, unitOf } from "./session";

type Field = HTMLInputElement | HTMLSelectElement;
/** Fields of the options, generated from the table of options; an option has the name of its field. */
const optionFields = (): Field[] => [...document.querySelectorAll<Field>("[data-option] input, [data-option] select")].filter((one) => one.id !== "priority");
const filled = (one: Field): string | boolean | null => one instanceof HTMLInputElement && one.type === "checkbox" ? one.checked : one.value || null;
const shown = (one: HTMLElement): boolean => !one.closest<HTMLElement>("[data-option]")!.hidden;
/** Factors and units for a verdict, as in the reports; a number without unit is a share. */
const UNITS: Record<string, [number, string]> = { m: [1000, "mm"], "m/s": [1000, "mm/s"], s: [1000, "ms"], "": [100, "%"] };
const EXISTS = 412; // status of an upload that would overwrite a file
const PLACED = ["path_deviation", "contour_error", "placement_error", "stitch_residual", "residual_vibration"];

export class Program {
  private asked = ""; // the fields of the calculation that this page asked for
  private calculated = ""; // the fields of the shown figures; empty if another page asked for them

  constructor(private readonly session: Session) {
    by("calculate").dataset.what = "calculate";
    by("calculate").onclick = () => this.calculate();
    by("zero-here").dataset.what = "zero-here";
    by("zero-here").onclick = () => this.zeroHere();
    by("cancel").dataset.what = "cancel";
    by("cancel").onclick = () => { this.asked = ""; session.link.act({ what: "cancel" }); };
    by<HTMLSelectElement>("priority").onchange = () => { by<HTMLInputElement>("feed").disabled = value("priority") !== "programmed"; };
    by<HTMLInputElement>("file").onchange = () => { const file = by<HTMLInputElement>("file").files?.[0]; if (file) void this.load(file.name, file); };
  }

  build(): void {
    const { session } = this;
    const simple = (text: string, what: string) => button(text, what, () => session.link.act({ what }));
    by("run").replaceChildren(button("Approach", "approach", () => session.hold({ what: "approach" })), button("Start", "start", () => this.start()), simple("Hold", "hold"), simple("Resume", "resume"));
    for (const one of document.querySelectorAll<HTMLElement>("[data-option]")) put(one, "hidden", !session.options.includes(one.dataset.option!));
    void this.list();
  }

  private fields(): string { return JSON.stringify([value("priority"), ...optionFields().map(filled)]); }

  /** Whether program or fields differ from those of the calculation: a start would run the calculated ones. */
  changed(state: State): boolean {
    return !!state.proven && (state.proven.program !== value("program") || (this.calculated !== "" && this.calculated !== this.fields()));
  }

  private calculate(): void {
    this.asked = this.fields();
    const priority = (shown(by("priority")) && value("priority")) || "programmed";
    const given = optionFields().filter((one) => shown(one) && filled(one) !== null && (one.id !== "feed" || priority === "programmed"));
    const options = Object.fromEntries(given.map((one) => [one.id.replaceAll("-", "_"), filled(one)]));
    this.session.link.act({ what: "calculate", program: value("program"), priority, ...options });
  }

  /** Take the position to which the machine was moved by hand as the program's zero. */
  private zeroHere(): void {
    const state = this.session.state;
    const parts = this.session.axes.flatMap(({ name, unit }) => {
      const at = state?.axes[name]?.commanded ?? 0, [scale] = unitOf(this.session, name);
      return Math.abs(at) < 1e-9 ? [] : [`${name}=${(at * scale).toFixed(3)} ${unit === "m" ? "mm" : "deg"}`];
    });
    by<HTMLInputElement>("offset").value = parts.join(", ");
  }

  private start(): void {
    const proven = this.session.state?.proven;
    if (proven) this.session.link.act({ what: "start", proof: proven.proof, override: this.reason(proven) });
  }

  /** The operator's reason to run out of specification; null for a plan in specification. */
  reason(proven: Proven): string | null { return proven.passed ? null : value("override"); }

  /** Upload a program to the project folder. */
  async load(name: string, content: Blob): Promise<boolean> {
    const put_ = (headers: Record<string, string>) => this.session.ask(`/api/programs/${encodeURIComponent(name)}`, { method: "PUT", body: content, headers });
    let answer = await put_({});
    if (answer.status === EXISTS && await asked((await answer.text()).trim(), "Overwrite it")) answer = await put_({ "X-Overwrite": "yes" });
    else if (answer.status === EXISTS) answer = new Response(`${name} was not loaded: the file of that name is kept`, { status: EXISTS });
    say(answer.ok ? `${name} is in the project folder` : (await answer.text()).trim(), !answer.ok);
    by<HTMLInputElement>("file").value = "";
    await this.list();
    const chosen = by<HTMLSelectElement>("program");
    if (answer.ok && [...chosen.options].some((one) => one.value === name)) chosen.value = name; // a drawing is no program
    return answer.ok;
  }

  async list(): Promise<void> {
    const answer = await this.session.ask("/api/programs");
    if (!answer.ok) { say(await answer.text(), true); return; }
    const chosen = by<HTMLSelectElement>("program"), before = chosen.value;
    chosen.replaceChildren(...((await answer.json()) as string[]).map((name) => made("option", name)));
    const now = before || this.session.figures?.program;
    if (now) chosen.value = now;
  }

  tell(found: Figures): void {
    [this.calculated, this.asked] = [this.asked, ""];
    if (this.calculated === "") by<HTMLSelectElement>("program").value = found.program; // chosen on another page, or before this page was reloaded
    const measured = (one: Criterion) => { const [by_, unit] = UNITS[one.unit] ?? [1, one.unit]; return `${(one.measured! * by_).toFixed(3)} ${unit}${one.limit === null ? "" : ` of ${(one.limit * by_).toFixed(3)} ${unit}`}`; };
    const shown = found.criteria.filter((one) => one.measured !== null && (one.status === "failed" || PLACED.includes(one.name)));
    const names = [...new Set(shown.map((one) => `${one.name.replaceAll("_", " ")}${one.axis ? ` ${one.axis}` : ""}`))];
    const worst = names.map((name) => shown.filter((one) => `${one.name.replaceAll("_", " ")}${one.axis ? ` ${one.axis}` : ""}` === name).reduce((a, b) => (b.measured! > a.measured! ? b : a)));
    const rows: [string, string, boolean][] = [
      ["program", found.program, false], ["verdict", found.closing, !found.passed], ["duration", `${found.duration_s.toFixed(2)} s`, false],
      ...(found.feed === null ? [] : [["feed", found.feed, false] as [string, string, boolean]]),
      ["ticks", String(found.ticks ?? "none"), false],
      ["circuits", found.circuits === null ? "1" : `${found.circuits}, ${found.ticks_per_circuit} ticks each on average`, false],
      ["points", String(found.points), false],
      ...worst.map((one, k) => [names[k]!, measured(one), one.status === "failed"] as [string, string, boolean]),
    ];
    by("figures").replaceChildren(...rows.flatMap(([name, text, wrong]) => { const dd = made("dd", text); if (wrong) dd.className = "wrong"; return [made("dt", name), dd]; }));
    for (const warning of found.warnings) say(warning);
  }

  forget(): void { by("figures").replaceChildren(); }

  show(state: State): void {
    put(by("cancel"), "hidden", state.calculating === null);
    put(by("override-row"), "hidden", !state.proven || state.proven.passed);
    put(by("changed"), "hidden", !this.changed(state) || this.session.machineMoves());
    put(by("busy"), "textContent", state.busy && state.calculating === null && !this.session.machineMoves() ? `Start and Calculate wait: ${state.busy}.` : "");
    const run = state.progress;
    put(by<HTMLProgressElement>("progress"), "value", state.calculating ?? (run ? Math.min(run.time_s / run.duration_s, 1) : 0));
    tell("progress-text", state.calculating !== null ? `calculating, ${Math.round(state.calculating * 100)} %` : !run ? "" : run.ended ? toldRun(run) : `${run.program}: ${run.time_s.toFixed(1)} s, ${Math.max(run.duration_s - run.time_s, 0).toFixed(1)} s left`);
    put(by("progress-text"), "className", run?.ended && state.calculating === null && run.verdict && !run.verdict.startsWith("IN SPEC") ? "wrong" : "");
  }

  /** Whether a start lacks its reason to run out of specification. */
  wantsReason(state: State): boolean { return !!state.proven && !state.proven.passed && value("override") === ""; }
}
