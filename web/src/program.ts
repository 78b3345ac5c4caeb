/** The program: load it, see it, calculate it, and run what was calculated. */

import { asked, button, by, intoSight, made, put, tell, value } from "./dom";
import { extentInWords } from "./extent";
import type { Figures, Preview, Proven, State } from "./messages";
import type { Session } from "./session";
import { toldEnd, toldRun, unitOf } from "./session";
import { note, say } from "./toasts";
import { tellRefusal, tellVerdict } from "./verdict";
import { inTrouble, isOf, timeOfDay } from "./wording";

type Field = HTMLInputElement | HTMLSelectElement;

const OF_PROGRAM = 'Replaces every feed of the program: "36 mm/s", "2000 mm/min", "10 count/tick".';
const OF_STITCHES = 'One speed for all stitches: "100 stitch/min".';
const NO_PROGRAM =
  "It is no program of this machine: it is a drawing, a table or a product, or work for another.";
const SHARES = 400; // steps of the progress: a new value draws it again
const LONG_S = 60; // from here on the time of day of the end is of use
const EXISTS = 412; // status of an upload that would overwrite a file
/** Fields of the options, generated from the table of options; an option has the name of its field. */
const optionFields = (): Field[] =>
  [...document.querySelectorAll<Field>("[data-option] input, [data-option] select")].filter(
    (one) => one.type !== "radio",
  );
const filled = (one: Field): string | boolean | null =>
  one instanceof HTMLInputElement && one.type === "checkbox" ? one.checked : one.value || null;
const shown = (one: HTMLElement): boolean => !one.closest<HTMLElement>("[data-option]")!.hidden;
const stops = () => [...document.querySelectorAll<HTMLInputElement>("#stops input")];
const presets = () => [...document.querySelectorAll<HTMLInputElement>("#priority input")];

export class Program {
  /** The chosen program before it is calculated; null if it cannot be shown. */
  preview: Preview | null = null;
  private asked = ""; // the fields of the calculation that this page asked for
  private calculated = ""; // the fields of the shown figures; empty if another page asked for them
  private looked = ""; // the program that was read for the preview
  private looks = 0; // number of the latest request for a preview

  /**
   * @param previewed called when the chosen program can be shown, and when it no longer can
   * @param toLine called with the line of the program that the operator wants to see
   */
  constructor(
    private readonly session: Session,
    private readonly previewed: () => void,
    private readonly toLine: (line: number) => void,
  ) {
    by("calculate").dataset.what = "calculate";
    by("calculate").onclick = () => void this.calculate();
    by("zero-here").dataset.what = "zero-here";
    by("zero-here").onclick = () => this.zeroHere();
    by("cancel").dataset.what = "cancel";
    by("cancel").onclick = () => {
      this.asked = "";
      session.link.act({ what: "cancel" });
    };
    for (const one of presets()) one.onchange = () => this.paced();
    this.takeStops();
    by<HTMLSelectElement>("program").onchange = () => void this.look();
    by<HTMLInputElement>("file").onchange = () => {
      const file = by<HTMLInputElement>("file").files?.[0];
      if (file) void this.load(file.name, file);
    };
    this.takeDropped();
  }

  build(): void {
    const { session } = this;
    const simple = (text: string, what: string) => button(text, what, () => session.link.act({ what }));
    by("run").replaceChildren(
      button("Approach", "approach", () => session.hold({ what: "approach" })),
      button("Start", "start", () => this.start()),
      simple("Hold", "hold"),
      simple("Resume", "resume"),
    );
    put(by("run").querySelector<HTMLElement>("[data-what=approach]")!, "hidden", !session.byHand);
    for (const one of document.querySelectorAll<HTMLElement>("[data-option]"))
      put(one, "hidden", !session.options.includes(one.dataset.option!));
    put(
      by("expert"),
      "hidden",
      document.querySelectorAll("#expert [data-option]:not([hidden])").length === 0,
    );
    put(by("stops"), "hidden", session.cylinders.length === 0);
    for (const one of presets())
      if (one.value === "accuracy") put(one.closest("label")!, "hidden", !session.normalFeed);
    this.paced();
    void this.list();
  }

  /** A choice of how cylinders stop fills the field of the shaper, and follows it. */
  private takeStops(): void {
    const shaper = by<HTMLInputElement>("shaper");
    for (const one of stops())
      one.onchange = () => {
        shaper.value = one.value;
      };
    shaper.addEventListener("input", () => {
      for (const one of stops()) one.checked = one.value === shaper.value.trim();
    });
  }

  private get priority(): string {
    return presets().find((one) => one.checked)?.value ?? "programmed";
  }

  /** A preset finds the feed; a job that is not paced by a feed has none. */
  private paced(): void {
    const byFeed = this.preview === null || this.preview.paced_by === "feed";
    const has = this.session.options.includes("interpolation");
    put(by("priority"), "hidden", !byFeed || !has);
    if (!byFeed) for (const one of presets()) one.checked = one.value === "programmed";
    const sewn = this.preview?.paced_by === "needle"; // a seam has the speed of its needle
    const feeds = !sewn && this.session.options.includes("feed");
    put(by("feed").closest<HTMLElement>("[data-option]")!, "hidden", !feeds);
    put(by<HTMLInputElement>("feed"), "disabled", this.priority !== "programmed");
    const [name, empty, told] = this.session.embroiders
      ? ["Speed", "the fastest of each stitch", OF_STITCHES]
      : ["Feed", "as programmed", OF_PROGRAM];
    put(document.querySelector<HTMLElement>("label[for=feed]")!, "textContent", name);
    put(by<HTMLInputElement>("feed"), "placeholder", empty);
    tell("feed-told", told);
  }

  private fields(): string {
    return JSON.stringify([this.priority, ...optionFields().map(filled)]);
  }

  /** Whether program or fields differ from those of the calculation: a start would run the calculated ones. */
  changed(state: State): boolean {
    return (
      !!state.proven &&
      (state.proven.program !== value("program") ||
        (this.calculated !== "" && this.calculated !== this.fields()))
    );
  }

  /** Choose a program and how fast it runs, and calculate it; return the number of the command, 0 for none. */
  calculateAs(name: string, priority: string): number {
    const chosen = by<HTMLSelectElement>("program");
    if (![...chosen.options].some((one) => one.value === name)) return 0;
    chosen.value = name;
    for (const one of presets()) one.checked = one.value === priority;
    void this.look();
    return this.calculate();
  }

  /** Whether a program is chosen. */
  get chosen(): boolean {
    return value("program") !== "";
  }

  /** Show why the chosen program has no verdict, until it is calculated again or another is chosen. */
  refused(why: string): void {
    tellRefusal(value("program"), why);
  }

  private calculate(): number {
    tellRefusal("", "");
    this.asked = this.fields();
    const priority = shown(by("priority")) ? this.priority : "programmed";
    const given = optionFields().filter(
      (one) => shown(one) && filled(one) !== null && (one.id !== "feed" || priority === "programmed"),
    );
    const options = Object.fromEntries(given.map((one) => [one.id.replaceAll("-", "_"), filled(one)]));
    return this.session.link.act({ what: "calculate", program: value("program"), priority, ...options });
  }

  /** Take the position to which the machine was moved by hand as the program's zero. */
  private zeroHere(): void {
    const state = this.session.state;
    const parts = this.session.axes.flatMap(({ name, unit }) => {
      const at = state?.axes[name]?.commanded ?? 0;
      const [scale] = unitOf(this.session, name);
      return Math.abs(at) < 1e-9 ? [] : [`${name}=${(at * scale).toFixed(3)} ${unit === "m" ? "mm" : "deg"}`];
    });
    by<HTMLInputElement>("offset").value = parts.join(", ");
  }

  private start(): void {
    const proven = this.session.state?.proven;
    if (proven) this.session.link.act({ what: "start", proof: proven.proof, override: this.reason(proven) });
  }

  /** The operator's reason to run out of specification; null for a plan in specification. */
  reason(proven: Proven): string | null {
    return proven.passed ? null : value("override");
  }

  // --- files ----------------------------------------------------------------------------------

  /** A file that is dropped anywhere on the page is loaded, while nothing moves. */
  private takeDropped(): void {
    const files = (event: DragEvent) => event.dataTransfer?.types.includes("Files") ?? false;
    const free = () => this.session.mine() && !this.session.machineMoves();
    window.addEventListener("dragover", (event) => {
      if (!files(event)) return;
      event.preventDefault(); // else the browser would leave the page for the file
      put(by("drop-here"), "hidden", !free());
    });
    window.addEventListener("dragleave", (event) => {
      if (event.relatedTarget === null) put(by("drop-here"), "hidden", true);
    });
    window.addEventListener("drop", (event) => {
      if (!files(event)) return;
      event.preventDefault();
      put(by("drop-here"), "hidden", true);
      if (free()) void this.loadAll([...event.dataTransfer!.files]);
      else say(this.session.mine() ? "wait until the machine stands" : "take control to load a file", true);
    });
  }

  private async loadAll(dropped: File[]): Promise<void> {
    for (const file of dropped) await this.load(file.name, file);
  }

  /** Upload a program to the project folder. */
  async load(name: string, content: Blob): Promise<boolean> {
    const put_ = (headers: Record<string, string>) =>
      this.session.ask(`/api/programs/${encodeURIComponent(name)}`, {
        method: "PUT",
        body: content,
        headers,
      });
    let answer = await put_({});
    if (answer.status === EXISTS && (await asked((await answer.text()).trim(), "Overwrite it")))
      answer = await put_({ "X-Overwrite": "yes" });
    else if (answer.status === EXISTS)
      answer = new Response(`${name} was not loaded: the file of that name is kept`, { status: EXISTS });
    const there = `${name} is in the project folder`;
    if (!answer.ok) say((await answer.text()).trim(), true);
    by<HTMLInputElement>("file").value = "";
    const names = await this.list(answer.ok ? name : "");
    if (answer.ok && names && !names.includes(name)) say(`${there}. ${NO_PROGRAM}`);
    else if (answer.ok && document.body.dataset.part === "prepare")
      note(there); // its list shows it
    else if (answer.ok) say(there);
    return answer.ok;
  }

  /** Read the list of programs and return it; choose one of them, if a drawing was loaded none. */
  async list(wanted = ""): Promise<string[] | null> {
    const answer = await this.session.ask("/api/programs");
    if (!answer.ok) {
      say(await answer.text(), true);
      return null;
    }
    const names = (await answer.json()) as string[];
    const chosen = by<HTMLSelectElement>("program");
    const before = chosen.value || this.session.figures?.program;
    const none = made("option", "no program is in the folder yet");
    none.value = "";
    chosen.replaceChildren(...(names.length ? names.map((name) => made("option", name)) : [none]));
    if (before) chosen.value = before;
    if (names.includes(wanted)) chosen.value = wanted;
    void (wanted ? this.look() : this.lookOnce());
    return names;
  }

  /** Read the chosen program for the part of the page that shows it, unless it was read. */
  async lookOnce(): Promise<void> {
    const read = value("program") === this.looked;
    if (!read && document.body.dataset.part === "prepare") await this.look();
  }

  /** Show the chosen program before it is calculated. */
  private async look(): Promise<void> {
    const program = value("program");
    this.looked = program;
    this.looks += 1;
    const look = this.looks;
    const path = `/api/programs/${encodeURIComponent(program)}/preview`;
    tell("reading", program === "" ? "" : `Reading ${program} to show it.`);
    const answer = program === "" ? null : await this.session.ask(path);
    if (look !== this.looks) return; // another was chosen meanwhile
    tell("reading", "");
    this.preview = answer?.ok ? ((await answer.json()) as Preview) : null;
    if (answer && !answer.ok) say((await answer.text()).trim(), true);
    if (this.preview && !this.preview.whole)
      say(`${program} is long: only its first ${this.preview.moves} moves are drawn`);
    const shown = this.preview;
    tell("extent", shown ? extentInWords(shown, (name) => unitOf(this.session, name)) : "");
    this.paced();
    this.previewed();
  }

  // --- what is calculated ---------------------------------------------------------------------

  tell(found: Figures): void {
    [this.calculated, this.asked] = [this.asked, ""];
    if (this.calculated === "" && value("program") !== found.program) {
      by<HTMLSelectElement>("program").value = found.program; // chosen on another page, or before a reload
      void this.lookOnce();
    }
    tellVerdict(found, this.toLine);
    for (const warning of found.warnings) note(warning);
    if (this.calculated) intoSight(by("verdict"));
  }

  forget(): void {
    tellVerdict(null, this.toLine);
  }

  show(state: State): void {
    put(by("cancel"), "hidden", state.calculating === null);
    put(by("override-row"), "hidden", !state.proven || state.proven.passed);
    put(by("changed"), "hidden", !this.changed(state) || this.session.machineMoves());
    const waits = state.busy && state.calculating === null && !this.session.machineMoves();
    tell("busy", waits ? `Start and Calculate wait: ${state.busy}.` : "");
    const run = state.progress;
    const share = state.calculating ?? (run ? Math.min(run.time_s / run.duration_s, 1) : 0);
    put(by<HTMLProgressElement>("progress"), "value", Math.round(share * SHARES) / SHARES);
    const [percent, more] = this.progressText(state);
    tell("percent", percent);
    tell("progress-more", more);
    put(by("progress-text"), "title", run?.ended ? more : ""); // a narrow bar cuts the end of a run off
    const wrong = !!run?.ended && state.calculating === null && inTrouble(run);
    put(by("progress-text"), "className", wrong ? "wrong" : "");
  }

  /** The share of a run that is done, and what stands behind it. */
  private progressText(state: State): [string, string] {
    if (state.calculating !== null) return ["", `calculating, ${Math.round(state.calculating * 100)} %`];
    const run = state.progress;
    if (!run) return ["", ""];
    if (run.ended) return ["", isOf(state.proven?.program ?? "", run) ? toldEnd(state) : toldRun(state)];
    const left = (Math.max(run.duration_s - run.time_s, 0) * 100) / state.feed_percent;
    const percent = Math.floor((100 * Math.min(run.time_s, run.duration_s)) / run.duration_s);
    const ends = state.state === "running" && left >= LONG_S ? `, ends at ${timeOfDay(left)}` : "";
    return [`${percent} %`, ends];
  }

  /** Whether a start lacks its reason to run out of specification. */
  wantsReason(state: State): boolean {
    return !!state.proven && !state.proven.passed && value("override") === "";
  }
}
