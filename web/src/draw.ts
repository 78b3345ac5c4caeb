/** Drawing with the pointer or typed coordinates: a stitch path, or the profile of a mandrel. */

import { by, made, typing, value } from "./dom";
import { FILLS, foreignShapes, ownShapes, patterns, radiusText, seamText, svgText } from "./drawing_files";
import type { Program } from "./program";
import type { Session } from "./session";
import type { Fill, Kind, Point, Shape, Style } from "./shapes";
import { bounds, filledTogether, LABEL_MM, middle, moved, NEEDS, pathData, scaled, turned } from "./shapes";
import { say } from "./toasts";
import { counted } from "./wording";

const SVG = "http://www.w3.org/2000/svg";
const NEAR_PX = 10;
const DASH: Record<Style, string> = { solid: "", dashed: "6 3", dotted: "1 3", dashdot: "8 3 1 3" };
const MOST_UNDONE = 100;

type Tool = Kind | "select";

export class Draw {
  private shapes: Shape[] = [];
  private chosen = new Set<number>(); // groups
  private pending: Point[] = [];
  private tool: Tool = "select";
  private before: string[] = []; // states for undo
  private after: string[] = []; // states for redo
  private dragged: Point | null = null;
  private pulled = false;
  private pointer: Point | null = null;
  private readonly svg = document.createElementNS(SVG, "svg");

  constructor(
    private readonly session: Session,
    private readonly program: Program,
  ) {
    this.svg.setAttribute("viewBox", "-10 -130 220 140");
    this.svg.setAttribute("tabindex", "0");
    this.svg.setAttribute("role", "application");
    this.svg.setAttribute("aria-label", "Drawing; points can be typed below");
    by("paper").append(this.svg);
    for (const tool of ["select", "line", "polygon", "arc", "circle", "spline", "leader"] as Tool[])
      this.action(tool[0]!.toUpperCase() + tool.slice(1), () => this.choose(tool)).dataset.tool = tool;
    const edits: [string, () => void][] = [
      ["Finish", () => this.finish()],
      [
        "Duplicate",
        () => this.change((one) => [one, { ...moved(one, [10, 10]), group: one.group + this.last() }]),
      ],
      ["Rotate", () => this.aboutMiddle("angle", (one, about, degrees) => turned(one, about, degrees))],
      ["Scale", () => this.aboutMiddle("factor", (one, about, factor) => scaled(one, about, factor))],
      ["Delete", () => this.change(() => [])],
      ["To front", () => this.order(true)],
      ["To back", () => this.order(false)],
      ["Undo", () => this.undo()],
      ["Redo", () => this.redo()],
      ["Fit", () => this.fit()],
      [
        "Clear",
        () => {
          this.keep();
          this.shapes = [];
          this.draw();
        },
      ],
    ];
    for (const [name, act] of edits) this.action(name, act);
    this.choose("select");
    this.svg.onpointerdown = (event) => this.down(event);
    this.svg.onpointermove = (event) => this.move(event);
    this.svg.onpointerup = () => {
      if (this.dragged) {
        this.dragged = null;
        this.grow();
        this.draw();
      }
    };
    this.svg.ondblclick = () => this.finish();
    this.svg.onkeydown = (event) => this.key(event);
    by<HTMLInputElement>("typed-point").onkeydown = (event) => {
      if (event.key === "Enter") this.typed();
    };
    by<HTMLSelectElement>("line-style").onchange = () => {
      if (this.chosen.size) this.change((one) => [{ ...one, style: value("line-style") as Style }]);
    };
    by<HTMLSelectElement>("fill").onchange = () => {
      if (this.chosen.size) this.change((one) => [{ ...one, fill: value("fill") as Fill }]);
    };
    by("add-text").onclick = () => void this.text();
    by("save-svg").onclick = () => void this.saveSvg(this.shapes);
    by("save-seam").onclick = () => void this.saveSeam();
    by("save-dxf").onclick = () => void this.saveDxf();
    by("as-mandrel").onclick = () => this.asMandrel();
    by<HTMLInputElement>("open-drawing").onchange = () => {
      const file = by<HTMLInputElement>("open-drawing").files?.[0];
      if (file) void this.open(file);
    };
    this.draw();
  }

  private action(name: string, act: () => void): HTMLButtonElement {
    const found = made("button", name);
    found.onclick = act;
    by("draw-tools").append(found);
    return found;
  }

  private choose(tool: Tool): void {
    this.finish();
    this.tool = tool;
    for (const one of document.querySelectorAll<HTMLButtonElement>("[data-tool]"))
      one.setAttribute("aria-pressed", String(one.dataset.tool === tool));
  }

  /** Highest group number. */
  private last(): number {
    return Math.max(0, ...this.shapes.map((one) => one.group));
  }

  private chosenShapes(): Shape[] {
    return this.shapes.filter((one) => this.chosen.has(one.group));
  }

  // --- points ---------------------------------------------------------------------------------

  private at(event: PointerEvent): Point {
    const box = this.svg.getScreenCTM()!,
      x = (event.clientX - box.e) / box.a,
      y = -(event.clientY - box.f) / box.d;
    return this.snapped([x, y], NEAR_PX / box.a);
  }

  /** A point of a shape nearby; else the nearest point of the grid. */
  private snapped([x, y]: Point, near: number): Point {
    const grid = Number(value("snap"));
    if (grid === 0) return [x, y];
    const still = this.dragged ? this.shapes.filter((one) => !this.chosen.has(one.group)) : this.shapes;
    const ends = still.flatMap((one) => one.points).filter((p) => Math.hypot(p[0] - x, p[1] - y) < near);
    return ends[0] ?? [Math.round(x / grid) * grid, Math.round(y / grid) * grid];
  }

  private down(event: PointerEvent): void {
    this.svg.focus();
    const at = this.at(event);
    if (this.tool !== "select") {
      this.add(at);
      return;
    }
    const hit = (event.target as Element).closest("path[data-at]") as SVGPathElement | null;
    if (!event.shiftKey) this.chosen.clear();
    if (hit) {
      this.chosen.add(this.shapes[Number(hit.dataset.at)]!.group);
      this.dragged = at;
      this.pulled = false;
      this.svg.setPointerCapture(event.pointerId);
    }
    this.draw();
  }

  private move(event: PointerEvent): void {
    const at = this.at(event);
    this.pointer = at;
    if (this.dragged) {
      const by_: Point = [at[0] - this.dragged[0], at[1] - this.dragged[1]];
      if (by_[0] === 0 && by_[1] === 0) return;
      if (!this.pulled) {
        this.keep();
        this.pulled = true;
      }
      this.dragged = at;
      this.shapes = this.shapes.map((one) => (this.chosen.has(one.group) ? moved(one, by_) : one));
    }
    if (this.dragged || this.pending.length) this.draw();
  }

  private typed(): void {
    const field = by<HTMLInputElement>("typed-point");
    if (field.value.trim() === "") {
      this.finish();
      return;
    }
    const [x, y] = field.value.split(/[ ,;]+/).map(Number);
    if (x === undefined || y === undefined || !Number.isFinite(x) || !Number.isFinite(y)) {
      say("a point is written x, y in mm", true);
      return;
    }
    if (this.tool === "select") {
      say("choose what to draw first", true);
      return;
    }
    field.value = "";
    this.add([x, y]);
    this.grow(); // a point set by the pointer is already in view
    this.draw();
  }

  private add(at: Point): void {
    const last = this.pending[this.pending.length - 1];
    if (last && last[0] === at[0] && last[1] === at[1]) return; // the second press of a double click
    this.pending.push(at);
    const [least, exact] = NEEDS[this.tool as Kind];
    if (exact && this.pending.length === least) this.finish();
    else this.draw();
  }

  private finish(): void {
    const points = this.pending;
    this.pending = [];
    if (this.tool !== "select" && points.length >= NEEDS[this.tool][0]) {
      this.keep();
      const group = this.last() + 1;
      this.shapes.push({
        kind: this.tool,
        points,
        style: value("line-style") as Style,
        fill: value("fill") as Fill,
        label: this.tool === "leader" ? value("text") : "",
        group,
      });
      this.chosen = new Set([group]);
      this.grow();
    }
    this.draw();
  }

  // --- changes --------------------------------------------------------------------------------

  private keep(): void {
    this.before.push(JSON.stringify(this.shapes));
    this.after = [];
    if (this.before.length > MOST_UNDONE) this.before.shift();
  }

  private undo(): void {
    if (this.pending.length) this.pending.pop();
    else this.goBack(this.before, this.after);
    this.draw();
  }

  private redo(): void {
    this.goBack(this.after, this.before);
    this.draw();
  }

  private goBack(from: string[], to: string[]): void {
    const found = from.pop();
    if (found === undefined) return;
    to.push(JSON.stringify(this.shapes));
    this.shapes = JSON.parse(found) as Shape[];
  }

  /** Rotate or scale the chosen shapes about their middle, by the number in a field. */
  private aboutMiddle(field: string, into: (shape: Shape, about: Point, by_: number) => Shape): void {
    const by_ = Number(value(field).replace(",", "."));
    if (!Number.isFinite(by_) || by_ === 0) {
      say("the angle or the factor must be a number other than 0", true);
      return;
    }
    const about = middle(this.chosenShapes());
    this.change((one) => [into(one, about, by_)]);
  }

  /** Replace each chosen shape by other shapes. */
  private change(into: (shape: Shape) => Shape[]): void {
    if (this.chosenShapes().length === 0) {
      say("nothing is chosen in the drawing");
      return;
    }
    this.keep();
    const before = new Set(this.shapes.map((one) => one.group));
    this.shapes = this.shapes.flatMap((one) => (this.chosen.has(one.group) ? into(one) : [one]));
    const fresh = this.shapes.map((one) => one.group).filter((group) => !before.has(group));
    if (fresh.length) this.chosen = new Set(fresh);
    this.grow();
    this.draw();
  }

  private order(front: boolean): void {
    this.keep();
    const rest = this.shapes.filter((one) => !this.chosen.has(one.group)),
      own = this.chosenShapes();
    this.shapes = front ? [...rest, ...own] : [...own, ...rest];
    this.draw();
  }

  private key(event: KeyboardEvent): void {
    if (typing()) return;
    const step = Number(value("snap")) || 1,
      by_ = (
        { ArrowLeft: [-step, 0], ArrowRight: [step, 0], ArrowUp: [0, step], ArrowDown: [0, -step] } as Record<
          string,
          Point
        >
      )[event.key];
    if (by_) {
      event.preventDefault();
      this.change((one) => [moved(one, by_)]);
    } else if (event.key === "Delete") this.change(() => []);
    else if (event.key === "z" && event.ctrlKey) this.undo();
    else if (event.key === "y" && event.ctrlKey) this.redo();
    else if (event.key === "Enter") this.finish();
    else if (event.key === "PageDown" || event.key === "PageUp") {
      event.preventDefault();
      this.chooseNext(event.key === "PageDown" ? 1 : -1);
    } else if (event.key === "a" && event.ctrlKey) {
      event.preventDefault();
      this.chosen = new Set(this.shapes.map((one) => one.group));
      this.draw();
    }
  }

  /** Choose the next or previous group, without a pointer. */
  private chooseNext(by_: number): void {
    const groups = [...new Set(this.shapes.map((one) => one.group))],
      now = groups.findIndex((group) => this.chosen.has(group));
    if (groups.length === 0) return;
    this.chosen = new Set([groups[((now < 0 && by_ < 0 ? 0 : now) + by_ + groups.length) % groups.length]!]);
    this.draw();
  }

  // --- files ----------------------------------------------------------------------------------

  private take(shapes: Shape[]): void {
    this.keep();
    this.shapes = shapes;
    this.chosen.clear();
    this.fit();
  }

  private async answered(path: string, content: BodyInit): Promise<Response | null> {
    const answer = await this.session.ask(path, { method: "POST", body: content });
    if (answer.ok) return answer;
    say((await answer.text()).trim(), true);
    return null;
  }

  private async open(file: File): Promise<void> {
    by<HTMLInputElement>("open-drawing").value = "";
    const own = file.name.toLowerCase().endsWith(".svg") ? ownShapes(await file.text()) : null;
    if (own) {
      this.take(own);
      return;
    }
    const answer = await this.answered(`/api/drawing/shapes?name=${encodeURIComponent(file.name)}`, file);
    if (!answer) return;
    const found = (await answer.json()) as { shapes: Shape[]; left_out: string[] };
    for (const one of found.left_out) say(`left out: ${one}`, true);
    this.take(foreignShapes(found.shapes, 0));
  }

  private async text(): Promise<void> {
    const answer = await this.answered(
      "/api/drawing/text",
      JSON.stringify({ text: value("text"), height_mm: Number(value("text-height")), font: value("font") }),
    );
    if (!answer) return;
    this.keep();
    const group = this.last();
    this.shapes.push(...foreignShapes((await answer.json()) as Shape[], group));
    this.chosen = new Set([group + 1]);
    this.grow();
    this.draw();
  }

  private async saveSvg(shapes: Shape[]): Promise<boolean> {
    return this.program.load(`${value("drawing-name")}.svg`, new Blob([svgText(shapes)]));
  }

  private async saveSeam(): Promise<void> {
    const sewn = this.shapes.filter((one) => one.kind !== "leader"); // leaders are notes: they are not sewn
    if (sewn.length === 0 || !(await this.saveSvg(sewn))) return;
    const name = value("drawing-name"),
      [low] = bounds(sewn);
    await this.program.load(
      `${name}.seam.toml`,
      new Blob([seamText(`${name}.svg`, Number(value("stitch")), Number(value("needle")), low)]),
    );
  }

  private async saveDxf(): Promise<void> {
    const answer = await this.answered(
      "/api/drawing/dxf",
      JSON.stringify(
        this.shapes.map(({ kind, points, style, fill, label, group }) => ({
          kind,
          points,
          style,
          fill,
          label,
          group,
        })),
      ),
    );
    if (!answer) return;
    const to = made("a");
    to.href = URL.createObjectURL(await answer.blob());
    to.download = `${value("drawing-name")}.dxf`;
    to.click();
    URL.revokeObjectURL(to.href);
  }

  private asMandrel(): void {
    const [line] = this.chosenShapes(),
      turns = this.session.axes.find((axis) => axis.unit === "rad"),
      along = this.session.axes.find((axis) => axis.unit === "m");
    const text = line && turns && along ? radiusText(line, turns.name, along.name) : "";
    if (text === "") {
      say(
        "a profile is one chosen line with increasing x and positive y, on a machine that turns a mandrel",
        true,
      );
      return;
    }
    by<HTMLInputElement>("radius").value = text;
    say(`mandrel for the next calculation: ${text}`);
  }

  // --- the picture ----------------------------------------------------------------------------

  private fit(): void {
    if (this.shapes.length) this.see(...bounds(this.shapes));
    this.draw();
  }

  /** Set the view to the rectangle between two corners, with a margin. */
  private see(low: Point, high: Point): void {
    const wide = Math.max(high[0] - low[0], (high[1] - low[1]) * 1.57, 20) * 1.2,
      x = (low[0] + high[0]) / 2,
      y = (low[1] + high[1]) / 2;
    this.svg.setAttribute("viewBox", `${x - wide / 2} ${-y - wide * 0.318} ${wide} ${wide * 0.636}`);
  }

  /** Enlarge the view if shapes lie beyond it. */
  private grow(): void {
    const next: Shape[] = this.pending.length
        ? [{ kind: "line", points: this.pending, style: "solid", fill: "none", label: "", group: 0 }]
        : [],
      all = [...this.shapes, ...next];
    if (all.length === 0) return;
    const box = this.svg.viewBox.baseVal,
      [low, high] = bounds(all),
      left = box.x,
      right = box.x + box.width,
      lowest = -box.y - box.height,
      highest = -box.y;
    if (low[0] >= left && high[0] <= right && low[1] >= lowest && high[1] <= highest) return;
    this.see(
      [Math.min(low[0], left), Math.min(low[1], lowest)],
      [Math.max(high[0], right), Math.max(high[1], highest)],
    );
  }

  private draw(): void {
    const part = (name: string, words: Record<string, string>) => {
      const found = document.createElementNS(SVG, name);
      for (const [key, text] of Object.entries(words)) found.setAttribute(key, text);
      return found;
    };
    const box = this.svg.viewBox.baseVal,
      cell = 10,
      lines: Element[] = [];
    for (let x = Math.ceil(box.x / cell) * cell; x < box.x + box.width; x += cell)
      lines.push(
        part("line", {
          x1: `${x}`,
          x2: `${x}`,
          y1: `${box.y}`,
          y2: `${box.y + box.height}`,
          class: x === 0 ? "zero" : "",
        }),
      );
    for (let y = Math.ceil(box.y / cell) * cell; y < box.y + box.height; y += cell)
      lines.push(
        part("line", {
          y1: `${y}`,
          y2: `${y}`,
          x1: `${box.x}`,
          x2: `${box.x + box.width}`,
          class: y === 0 ? "zero" : "",
        }),
      );
    const shapes = filledTogether(this.shapes).map(({ at, of: [one, ...others] }) =>
      part("path", {
        d: [one!, ...others].map(pathData).join(" "),
        "data-at": String(at),
        "fill-rule": "evenodd",
        class: this.chosen.has(one!.group) ? "chosen" : "",
        fill: one!.kind === "leader" ? "none" : FILLS[one!.fill],
        "stroke-dasharray": DASH[one!.style],
      }),
    );
    const points = [...this.pending, ...(this.pending.length && this.pointer ? [this.pointer] : [])];
    if (points.length > 1) {
      const kind = this.tool === "arc" && points.length < 3 ? "line" : (this.tool as Kind);
      shapes.push(
        part("path", {
          d: pathData({ kind, points, style: "dashed", fill: "none", label: "", group: 0 }),
          class: "pending",
          fill: "none",
        }),
      );
    }
    const handles = this.chosenShapes()
      .flatMap((one) => (one.points.length > 40 ? [] : one.points))
      .concat(this.pending)
      .map(([x, y]) => part("circle", { cx: `${x}`, cy: `${-y}`, r: `${box.width / 250}` }));
    const labels = this.shapes
      .filter((one) => one.label)
      .map((one) => {
        const [x, y] = one.points[one.points.length - 1]!,
          found = part("text", { x: `${x + 1}`, y: `${-y}`, "font-size": String(LABEL_MM) });
        found.textContent = one.label;
        return found;
      });
    const fills = part("g", {});
    fills.innerHTML = patterns(0.4);
    this.svg.replaceChildren(fills, ...lines, ...shapes, ...labels, ...handles);
    by("drawn").textContent =
      `${counted(this.shapes.length, "shape")}${this.pending.length ? `, ${counted(this.pending.length, "point")} of the next` : ""}${this.pointer ? `, ${this.pointer.map((v) => v.toFixed(1)).join(", ")} mm` : ""}`;
  }
}
