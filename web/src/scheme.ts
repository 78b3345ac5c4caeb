/** A schematic of a machine with cylinders: pistons, end switches and valves, and lamps for what else it has. */

import { made } from "./dom";
import type { Cylinder, State } from "./messages";
import { shown } from "./positions";
import { sizeOf } from "./visibility";

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

/** Where the pistons are, m or rad, and which signals are on; what is not known is not there. */
export interface Told {
  at: Record<string, number>;
  on: Record<string, boolean>;
}

/** What a state tells. */
export function toldBy(state: State): Told {
  const at: Record<string, number> = {};
  for (const [name, place] of Object.entries(state.axes)) {
    const where = place.load ?? place.measured ?? place.commanded;
    if (where !== null) at[name] = where;
  }
  return { at, on: Object.fromEntries(Object.entries(state.signals).map(([name, on]) => [name, on !== 0])) };
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
  private drawn = "";

  constructor(private readonly parts: Parts) {
    this.element.className = "scheme";
    this.element.append(this.drawing);
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

  draw(told: Told, wide = sizeOf(this.element)[0]): void {
    const key = JSON.stringify([told, wide]);
    if (key === this.drawn) return;
    this.drawn = key;
    for (const [name, [row, word]] of this.lamps) {
      const on = told.on[name];
      const look = on === undefined ? "unknown" : on ? "on" : "";
      if (row.className === look && word.textContent) continue;
      row.className = look;
      word.textContent = on === undefined ? ", not told" : on ? ", on" : ", off";
    }
    const each = TALL + (wide < NARROW ? 18 : 0);
    this.drawing.setAttribute("width", String(wide));
    this.drawing.setAttribute("height", String(each * this.parts.cylinders.length + 4));
    this.drawing.replaceChildren(
      ...this.parts.cylinders.flatMap((one, k) => this.cylinder(one, told, k * each + 4, wide)),
    );
  }

  private cylinder(one: Cylinder, told: Told, y: number, wide: number): SVGElement[] {
    const [scale, unit] = one.unit === "rad" ? [180 / Math.PI, "°"] : [1000, "mm"];
    const [left, beyond] = wide < NARROW ? [LEFT_NARROW, 30] : [LEFT, 60];
    const long = wide - left - RIGHT - beyond; // the rod is seen beyond the barrel
    const x = (at: number) => left + (Math.min(Math.max(at / one.stroke, 0), 1) || 0) * (long - 10);
    const at = told.at[one.name];
    const found = [
      part("text", { x: 4, y: y + 11, class: "name" }, one.name),
      part("text", { x: 4, y: y + 26 }, at === undefined ? "not known" : `${shown(at * scale)} ${unit}`),
      part("rect", { x: left, y, width: long, height: BARREL, class: "cylinder" }),
    ];
    if (at !== undefined)
      found.push(
        part("rect", { x: x(at), y: y + 9, width: left + long + beyond - x(at), height: 4, class: "rod" }),
        part("rect", { x: x(at), y, width: 10, height: BARREL, class: "piston" }),
      );
    for (const end of one.contacts) {
      const near = end.beyond === "below";
      const [cx, text] = [x(end.at) + 5, spoken(end.name)];
      const on = told.on[end.name];
      found.push(
        part("line", { x1: cx, x2: cx, y1: y + BARREL, y2: y + BARREL + 6, class: "lead" }),
        part("circle", {
          cx,
          cy: y + BARREL + 11,
          r: 5,
          class: on ? "lamp on" : "lamp",
          "data-signal": end.name,
        }),
        part(
          "text",
          { x: near ? cx + 10 : cx - 10, y: y + BARREL + 15, "text-anchor": near ? "start" : "end" },
          text,
        ),
      );
    }
    const below = y + BARREL + 31;
    const middle = wide < NARROW ? left : left + long / 2;
    const second = wide < NARROW ? below + 18 : below;
    return [
      ...found,
      ...this.way("→", one.forward, told, left, below),
      ...this.way("←", one.back, told, middle, second),
    ];
  }

  /** The valve and the flow controls of one way, with a lamp each. */
  private way(arrow: string, names: string[], told: Told, left: number, y: number): SVGElement[] {
    const found = [part("text", { x: left, y: y + 4 }, arrow)];
    let x = left + 18;
    for (const [k, text] of ofWay(names).entries()) {
      const name = names[k]!;
      found.push(
        part("circle", {
          cx: x + 5,
          cy: y,
          r: 5,
          class: told.on[name] ? "lamp on" : "lamp",
          "data-signal": name,
        }),
        part("text", { x: x + 14, y: y + 4 }, text),
      );
      x += 26 + LETTER * text.length;
    }
    return found;
  }
}
