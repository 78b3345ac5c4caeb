/** Shapes of a drawing, in mm, y upwards. Points define a shape completely: moving and turning change only points. */

export type Point = [number, number];
export type Kind = "line" | "polygon" | "arc" | "circle" | "spline" | "leader";
export type Style = "solid" | "dashed" | "dotted" | "dashdot";
export type Fill = "none" | "solid" | "hatched" | "crossed";

/** Points: of a line, two or more; of an arc, its start, a point on it, its end; of a circle, its centre and a point on it; of a leader, its tip first and the place of its label last. */
export interface Shape {
  kind: Kind;
  points: Point[];
  style: Style;
  fill: Fill;
  label: string /** Shapes with the same group are chosen together. */;
  group: number;
}

const HEAD = [4, 1.2]; // length and half width of a leader's head, mm
export const LABEL_MM = 4;

/** Number of points of a shape: the least, or the exact number. */
export const NEEDS: Record<Kind, [number, boolean]> = {
  line: [2, false],
  polygon: [3, false],
  arc: [3, true],
  circle: [2, true],
  spline: [3, false],
  leader: [2, false],
};

const distance = (a: Point, b: Point): number => Math.hypot(a[0] - b[0], a[1] - b[1]);

export function moved(shape: Shape, by: Point): Shape {
  return { ...shape, points: shape.points.map(([x, y]) => [x + by[0], y + by[1]]) };
}

export function turned(shape: Shape, about: Point, degrees: number): Shape {
  const c = Math.cos((degrees * Math.PI) / 180),
    s = Math.sin((degrees * Math.PI) / 180);
  return {
    ...shape,
    points: shape.points.map(([x, y]) => [
      about[0] + c * (x - about[0]) - s * (y - about[1]),
      about[1] + s * (x - about[0]) + c * (y - about[1]),
    ]),
  };
}

export function scaled(shape: Shape, about: Point, factor: number): Shape {
  return {
    ...shape,
    points: shape.points.map(([x, y]) => [
      about[0] + factor * (x - about[0]),
      about[1] + factor * (y - about[1]),
    ]),
  };
}

export function middle(shapes: Shape[]): Point {
  const [low, high] = bounds(shapes);
  return [(low[0] + high[0]) / 2, (low[1] + high[1]) / 2];
}

/** Shapes that are filled together, and the index of the first: within a group, a shape inside another is a hole, as in letters. */
export function filledTogether(shapes: Shape[]): { at: number; of: Shape[] }[] {
  const found: { at: number; of: Shape[] }[] = [];
  shapes.forEach((shape, at) => {
    const last = found[found.length - 1],
      like = last?.of[0];
    const alike =
      like &&
      shape.fill !== "none" &&
      shape.kind !== "leader" &&
      like.kind === shape.kind &&
      like.group === shape.group &&
      like.fill === shape.fill &&
      like.style === shape.style;
    if (alike) last!.of.push(shape);
    else found.push({ at, of: [shape] });
  });
  return found;
}

/** Corners of the box around the shapes' points; curves may reach a little beyond it. */
export function bounds(shapes: Shape[]): [Point, Point] {
  const all = shapes.flatMap((shape) => (shape.kind === "circle" ? reach(shape) : shape.points));
  return [
    [Math.min(...all.map((p) => p[0])), Math.min(...all.map((p) => p[1]))],
    [Math.max(...all.map((p) => p[0])), Math.max(...all.map((p) => p[1]))],
  ];
}

function reach(circle: Shape): Point[] {
  const [centre, rim] = circle.points as [Point, Point],
    r = distance(centre, rim);
  return [
    [centre[0] - r, centre[1] - r],
    [centre[0] + r, centre[1] + r],
  ];
}

/** Centre of the circle through three points; null where they lie on a line. */
export function centreOf(a: Point, b: Point, c: Point): Point | null {
  const d = 2 * (a[0] * (b[1] - c[1]) + b[0] * (c[1] - a[1]) + c[0] * (a[1] - b[1]));
  if (Math.abs(d) < 1e-9) return null;
  const [aa, bb, cc] = [a, b, c].map((p) => p[0] * p[0] + p[1] * p[1]) as [number, number, number];
  return [
    (aa * (b[1] - c[1]) + bb * (c[1] - a[1]) + cc * (a[1] - b[1])) / d,
    (aa * (c[0] - b[0]) + bb * (a[0] - c[0]) + cc * (b[0] - a[0])) / d,
  ];
}

/** Control points of the cubic pieces of a Catmull-Rom spline through points: three after each but the first. */
export function controls(points: Point[]): Point[] {
  const at = (k: number): Point => points[Math.min(Math.max(k, 0), points.length - 1)]!;
  return points.slice(1).flatMap((to, k) => {
    const [before, from, after] = [at(k - 1), at(k), at(k + 2)];
    return [
      [from[0] + (to[0] - before[0]) / 6, from[1] + (to[1] - before[1]) / 6],
      [to[0] - (after[0] - from[0]) / 6, to[1] - (after[1] - from[1]) / 6],
      to,
    ] as Point[];
  });
}

const told = ([x, y]: Point): string => `${Number(x.toFixed(4))} ${Number((-y).toFixed(4)) + 0}`;

/** SVG path data, with y downwards. */
export function pathData(shape: Shape): string {
  const [a, b, c] = shape.points as [Point, Point, Point];
  if (shape.kind === "circle") {
    const r = distance(a, b).toFixed(4),
      left: Point = [a[0] - Number(r), a[1]],
      right: Point = [a[0] + Number(r), a[1]];
    return `M ${told(left)} A ${r} ${r} 0 1 0 ${told(right)} A ${r} ${r} 0 1 0 ${told(left)} Z`;
  }
  if (shape.kind === "arc" && c) {
    const centre = centreOf(a, b, c);
    if (!centre) return `M ${told(a)} L ${told(c)}`;
    const side = (c[0] - a[0]) * (b[1] - a[1]) - (c[1] - a[1]) * (b[0] - a[0]); // on which side of the chord it passes
    const other = (c[0] - a[0]) * (centre[1] - a[1]) - (c[1] - a[1]) * (centre[0] - a[0]);
    const r = distance(centre, a).toFixed(4);
    return `M ${told(a)} A ${r} ${r} 0 ${side * other > 0 ? 1 : 0} ${side > 0 ? 1 : 0} ${told(c)}`;
  }
  if (shape.kind === "spline") {
    const by = controls(shape.points),
      pieces = by.flatMap((_, k) =>
        k % 3 === 0 ? [`C ${told(by[k]!)} ${told(by[k + 1]!)} ${told(by[k + 2]!)}`] : [],
      );
    return `M ${told(a)} ${pieces.join(" ")}`;
  }
  if (shape.kind === "leader") {
    const long = distance(a, b) || 1,
      along: Point = [(b[0] - a[0]) / long, (b[1] - a[1]) / long],
      [length, half] = HEAD as [number, number];
    const barb = (side: number): Point => [
      a[0] + length * along[0] - side * half * along[1],
      a[1] + length * along[1] + side * half * along[0],
    ];
    return `M ${shape.points.map(told).join(" L ")} M ${told(barb(1))} L ${told(a)} L ${told(barb(-1))}`;
  }
  return `M ${shape.points.map(told).join(" L ")}${shape.kind === "polygon" ? " Z" : ""}`;
}
