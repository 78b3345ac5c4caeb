/** The view: mandrel or bed in three dimensions, the cloth from above, or the steps of a cycle. */

import { Cloth } from "./cloth";
import { by, put, tell } from "./dom";
import type { Figures, Mandrel, Preview, State, Welcome } from "./messages";
import type { Picture, Shown } from "./picture";
import type { Parts } from "./scheme";
import { Steps } from "./steps";
import { View3d } from "./view3d";

const CLOSER = 1.5; // factor of the zoom at each press
const LONGEST_S = 15; // longest playing time of a simulation, s

export class View {
  private picture: Picture | null = null;
  private shown: Shown | null = null;
  private times = false; // whether the job is calculated
  private playing: number | null = null; // start of the simulation by the page's clock, ms
  private readonly made = new Map<string, Picture | null>();
  private parts: Parts = { cylinders: [], inputs: [], outputs: [] };
  private bare = "space"; // the picture of the machine without a job

  constructor(
    private readonly place: HTMLElement,
    private readonly moves: () => boolean,
    private readonly ask: (path: string) => Promise<Response>,
  ) {
    by("simulate").onclick = () => {
      const may = this.playing === null && this.times && !moves();
      this.playing = may ? performance.now() : null;
    };
    new ResizeObserver(() => this.picture?.resize()).observe(place);
    for (const [id, factor] of Object.entries({ "zoom-in": CLOSER, "zoom-out": 1 / CLOSER, "zoom-fit": 0 }))
      by(id).onclick = () => this.picture?.zoom?.(factor);
  }

  /** Draw a machine: a bed, the cylinders, or a cloth. */
  of(welcome: Welcome): void {
    const { cylinders, inputs, outputs } = welcome;
    const parts = { cylinders, inputs, outputs };
    this.bare = cylinders.length ? "steps" : welcome.by_hand ? "space" : "cloth";
    if (JSON.stringify(parts) !== JSON.stringify(this.parts)) this.made.delete("steps");
    this.parts = parts;
  }

  /** Ticks of the page's clock between two pictures. */
  get ticks(): number {
    return this.picture instanceof View3d && this.picture.slow ? 7 : 2;
  }

  /** Show a calculated job; else the preview of one; else the bare machine. */
  show(figures: Figures | null, preview: Preview | null, bare: Mandrel | null): void {
    this.playing = null;
    this.times = figures !== null;
    this.shown = figures ?? (preview && { ...preview, proof: "", times_s: [], duration_s: 0, lanes: [] });
    const work = this.shown?.stitches ? "cloth" : this.shown?.steps.length ? "steps" : "";
    const kind = work || this.bare;
    const next = this.kind(kind);
    document.body.dataset.view = kind;
    if (next !== this.picture) {
      this.place.replaceChildren(...(next ? [next.element] : []));
      this.picture = next;
    }
    put(by("seen-from"), "hidden", !next?.turns);
    put(by("zoom"), "hidden", !next?.zoom);
    put(by("seen-as"), "hidden", true);
    next?.show(this.shown, this.shown?.mandrel ?? bare);
    next?.resize();
    this.tellLegend();
  }

  private tellLegend(): void {
    const legend = this.picture?.legend() ?? [];
    by("legend").replaceChildren(
      ...legend.map(([colour, text]) => {
        const found = document.createElement("span");
        const mark = document.createElement("i");
        mark.style.background = colour;
        found.append(mark, text);
        return found;
      }),
    );
  }

  private kind(kind: string): Picture | null {
    const known = this.made.get(kind);
    if (known !== undefined) return known;
    let found: Picture | null = null;
    try {
      found =
        kind === "cloth"
          ? new Cloth(() => this.tellLegend())
          : kind === "steps"
            ? new Steps(this.parts)
            : this.inSpace();
    } catch {
      tell("seen", "this browser has no WebGL: it cannot show the view in three dimensions");
    }
    this.made.set(kind, found);
    return found;
  }

  private inSpace(): View3d {
    return new View3d(this.ask, () => this.tellLegend());
  }

  /** Show the live position of the machine. */
  live(state: State): void {
    if (this.playing !== null && !this.moves()) return;
    this.playing = null;
    if (!this.picture) return;
    this.picture.live(state);
    const waits =
      this.shown && !this.times ? "not calculated yet: the programmed path" : "the machine, at rest";
    tell("seen", this.moves() ? "the machine, now" : waits);
  }

  draw(): void {
    put(by<HTMLButtonElement>("simulate"), "disabled", !this.times || this.moves());
    tell("simulate", this.playing === null ? "Simulate" : "End simulation");
    const { shown } = this;
    if (this.playing !== null && shown && this.picture) {
      const pace = Math.max(shown.duration_s / LONGEST_S, 1);
      const time_s = (pace * (performance.now() - this.playing)) / 1000;
      this.picture.at(time_s);
      const at = Math.min(time_s, shown.duration_s).toFixed(1);
      const of = `${at} of ${shown.duration_s.toFixed(1)} s, ${pace.toFixed(1)} times as fast`;
      tell("seen", `SIMULATED, not the machine: ${of}`);
      if (time_s > shown.duration_s + 1) this.playing = null;
    }
    this.picture?.draw();
  }
}
