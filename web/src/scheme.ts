/** A schematic of a machine with cylinders: pistons, end switches and valves, and lamps for what else it has. */

import { change, made, put } from "./dom";
import type { Cylinder, State } from "./messages";
import { shown } from "./positions";
import { sizeOf } from "./visibility";
import { isHomed, unknownPlace, whyUnknown } from "./wording";

const SVG = "http://www.w3.org/2000/svg";
const LEFT = 110; // as in the timing diagram below it
const LEFT_NARROW = 80; // room for "165.27 mm"
const RIGHT = 14;
const BARREL = 22;
const TALL = 66; // of a cylinder with its switches and valves
const NARROW = 460; // below this width the valves of the two ways stand below each other
const LETTER = 6.6;

export function part(name: string, words: Record<string, string | number>, text = ""): SVGElement {
  const found = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(words)) found.setAttribute(key, String(value));
  if (text) found.textContent = text;
  return found;
}

/** The name of an input or output as it is read: "x_is_left" is "x is left". */
export function spoken(name: string): string {
  return name.replaceAll("_", " ");
}

/** The names of the outputs of one way; a flow control without the name of its valve: "x right", "a1". */
export function ofWay(names: string[]): string[] {
  const [valve, ...flows] = names;
  if (valve === undefined) return [];
  return [
    valve,
    ...flows.map((one) => (one.startsWith(`${valve}_`) ? one.slice(valve.length + 1) : one)),
  ].map(spoken);
}

/** Signals of a machine that belong to none of its cylinders. */
export function others(cylinders: Cylinder[], names: string[]): string[] {
  const own = new Set(
    cylinders.flatMap((one) => [...one.forward, ...one.back, ...one.contacts.map((at) => at.name)]),
  );
  return names.filter((name) => !own.has(name));
}

/** Places of the pistons, m or rad, and signals that are on; unknown ones are missing. */
export interface Told {
  at: Record<string, number>;
  on: Record<string, boolean>;
  /** Whether the machine is homed; a plan always is. */
  homed: boolean;
}

/** The pistons and signals of a state. */
export function toldBy(state: State): Told {
  const at: Record<string, number> = {};
  for (const [name, place] of Object.entries(state.axes)) {
    const where = place.load ?? place.measured ?? place.commanded;
    if (where !== null) at[name] = where;
  }
  const on = Object.entries(state.signals).map(([name, one]): [string, boolean] => [name, one !== 0]);
  return { at, on: Object.fromEntries(on), homed: isHomed(state.state) };
}

/** The cylinders and signals of a machine. */
export interface Parts {
  cylinders: Cylinder[];
  inputs: string[];
  outputs: string[];
}

export class Scheme {
  readonly element = made("div");
  private readonly drawing = part("svg", {
    role: "img",
    "aria-label": "cylinders with their contacts and valves",
  });
  private readonly lamps = new Map<string, [HTMLLIElement, HTMLSpanElement]>();
  private readonly marks = new Map<string, SVGElement[]>(); // lamps in the drawing
  private readonly pistons = new Map<string, [SVGElement, SVGElement, SVGElement]>(); // place, rod, piston
  private readonly hint = made("p");
  private drawn = "";
  private wide = 0; // pixels; not known yet

  constructor(private readonly parts: Parts) {
    this.element.className = "scheme";
    this.hint.className = "hint";
    this.element.append(this.drawing, this.hint);
    for (const [title, names] of [
      ["Inputs", others(parts.cylinders, parts.inputs)],
      ["Outputs", others(parts.cylinders, parts.outputs)],
    ] as [string, string[]][]) {
      if (names.length === 0) continue;
      const list = made("ul");
      const row = made("div");
      list.setAttribute("aria-label", title);
      list.append(...names.map((name) => this.lamp(name)));
      row.className = "lamps";
      row.append(made("span", title), list);
      this.element.append(row);
    }
  }

  private lamp(name: string): HTMLLIElement {
    const row = made("li", spoken(name));
    const word = made("span");
    word.className = "unseen"; // for those who do not see the lamp
    row.append(word);
    this.lamps.set(name, [row, word]);
    return row;
  }

  /** Draw it as wide as there is room. */
  resize(wide: number): void {
    if (wide === this.wide) return;
    this.wide = wide;
    this.lay();
    this.drawn = "";
  }

  draw(told: Told): void {
    if (this.wide === 0) this.resize(sizeOf(this.element)[0]);
    const key = JSON.stringify(told);
    if (key === this.drawn) return;
    this.drawn = key;
    for (const [name, [row, word]] of this.lamps) {
      const on = told.on[name];
      const look = on === undefined ? "unknown" : on ? "on" : "";
      if (row.className === look && word.textContent) continue;
      row.className = look;
      word.textContent = on === undefined ? ", not known" : on ? ", on" : ", off";
    }
    for (const [name, lamps] of this.marks) {
      const on = told.on[name];
      for (const lamp of lamps)
        change(lamp, "class", on === undefined ? "lamp unknown" : on ? "lamp on" : "lamp");
    }
    for (const one of this.parts.cylinders) this.stand(one, told);
    const known = this.parts.cylinders.every((one) => told.at[one.name] !== undefined);
    put(this.hint, "hidden", known);
    put(this.hint, "textContent", known ? "" : whyUnknown(told.homed));
  }

  /** Show where a piston is. */
  private stand(one: Cylinder, told: Told): void {
    const [text, rod, piston] = this.pistons.get(one.name)!;
    const [scale, unit] = one.unit === "rad" ? [180 / Math.PI, "°"] : [1000, "mm"];
    const at = told.at[one.name];
    put(text, "textContent", at === undefined ? unknownPlace(told.homed) : `${shown(at * scale)} ${unit}`);
    for (const drawn of [rod, piston]) change(drawn, "visibility", at === undefined ? "hidden" : "visible");
    if (at === undefined) return;
    const x = this.x(one, at);
    change(rod, "x", x.toFixed(1));
    change(rod, "width", (this.left + this.long + this.beyond - x).toFixed(1));
    change(piston, "x", x.toFixed(1));
  }

  private get left(): number {
    return this.wide < NARROW ? LEFT_NARROW : LEFT;
  }

  /** How far a rod is seen beyond its barrel. */
  private get beyond(): number {
    return this.wide < NARROW ? 30 : 60;
  }

  private get long(): number {
    return this.wide - this.left - RIGHT - this.beyond;
  }

  private x(one: Cylinder, at: number): number {
    return this.left + (Math.min(Math.max(at / one.stroke, 0), 1) || 0) * (this.long - 10);
  }

  /** Make the parts of all cylinders, in the present width. */
  private lay(): void {
    this.marks.clear();
    const { wide } = this;
    const each = TALL + (wide < NARROW ? 18 : 0);
    this.drawing.setAttribute("width", String(wide));
    this.drawing.setAttribute("height", String(each * this.parts.cylinders.length + 4));
    this.drawing.replaceChildren(
      ...this.parts.cylinders.flatMap((one, k) => this.cylinder(one, k * each + 4)),
    );
  }

  private mark(name: string, cx: number, cy: number): SVGElement {
    const found = part("circle", { cx, cy, r: 5, class: "lamp", "data-signal": name });
    this.marks.set(name, [...(this.marks.get(name) ?? []), found]);
    return found;
  }

  private cylinder(one: Cylinder, y: number): SVGElement[] {
    const { wide, left, long } = this;
    const text = part("text", { x: 4, y: y + 26 });
    const rod = part("rect", { x: 0, y: y + 9, width: 0, height: 4, class: "rod" });
    const piston = part("rect", { x: 0, y, width: 10, height: BARREL, class: "piston" });
    this.pistons.set(one.name, [text, rod, piston]);
    const found = [
      part("text", { x: 4, y: y + 11, class: "name" }, one.name),
      text,
      part("rect", { x: left, y, width: long, height: BARREL, class: "cylinder" }),
      rod,
      piston,
    ];
    for (const end of one.contacts) {
      const near = end.beyond === "below";
      const cx = this.x(one, end.at) + 5;
      found.push(
        part("line", { x1: cx, x2: cx, y1: y + BARREL, y2: y + BARREL + 6, class: "lead" }),
        this.mark(end.name, cx, y + BARREL + 11),
        part(
          "text",
          { x: near ? cx + 10 : cx - 10, y: y + BARREL + 15, "text-anchor": near ? "start" : "end" },
          spoken(end.name),
        ),
      );
    }
    const below = y + BARREL + 31;
    const middle = wide < NARROW ? left : left + long / 2;
    const second = wide < NARROW ? below + 18 : below;
    return [...found, ...this.way("→", one.forward, left, below), ...this.way("←", one.back, middle, second)];
  }

  /** The valve and the flow controls of one way, with a lamp each. */
  private way(arrow: string, names: string[], left: number, y: number): SVGElement[] {
    const found = [part("text", { x: left, y: y + 4 }, arrow)];
    let x = left + 18;
    for (const [k, text] of ofWay(names).entries()) {
      const name = names[k]!;
      found.push(this.mark(name, x + 5, y), part("text", { x: x + 14, y: y + 4 }, text));
      x += 26 + LETTER * text.length;
    }
    return found;
  }
}
