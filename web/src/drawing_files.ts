/** Files of drawings: the page's own SVG; DXF and other SVG, through the server; seams and mandrels from a drawing. */

import type { Fill, Kind, Point, Shape, Style } from "./shapes";
import { bounds, filledTogether, LABEL_MM, pathData } from "./shapes";

const DASHES: Record<Style, string> = { solid: "", dashed: "4 2", dotted: "0.5 1.5", dashdot: "6 2 0.5 2" };
export const FILLS: Record<Fill, string> = {
  none: "none",
  solid: "#cccccc",
  hatched: "url(#hatched)",
  crossed: "url(#crossed)",
};
/** SVG patterns of the fills; line width in mm. */
export const patterns = (wide: number): string =>
  `<defs><pattern id="hatched" width="3" height="3" patternUnits="userSpaceOnUse" patternTransform="rotate(45)"><path d="M 0 0 V 3" stroke="#777777" stroke-width="${wide}"/></pattern><pattern id="crossed" width="3" height="3" patternUnits="userSpaceOnUse" patternTransform="rotate(45)"><path d="M 0 0 V 3 M 0 0 H 3" stroke="#777777" stroke-width="${wide}"/></pattern></defs>`;
const escaped = (text: string): string => text.replace(/[&<>"]/g, (one) => `&#${one.charCodeAt(0)};`);
const MARGIN = 5;

/** SVG text in mm, with data from which ownShapes reads the same shapes. */
export function svgText(shapes: Shape[]): string {
  const [low, high] = shapes.length
    ? bounds(shapes)
    : ([
        [0, 0],
        [100, 100],
      ] as [Point, Point]);
  const x = low[0] - MARGIN,
    y = -high[1] - MARGIN,
    width = high[0] - low[0] + 2 * MARGIN,
    height = high[1] - low[1] + 2 * MARGIN;
  const points = (shape: Shape): string =>
    shape.points.map((p) => p.map((v) => Number(v.toFixed(6))).join(",")).join(" ");
  const paths = filledTogether(shapes)
    .map(({ of }) => ({ of, shape: of[0]! }))
    .map(
      ({ of, shape }) =>
        `  <path d="${of.map(pathData).join(" ")}" fill-rule="evenodd" fill="${shape.kind === "leader" ? "none" : FILLS[shape.fill]}" stroke="#000000" stroke-width="0.3"${DASHES[shape.style] ? ` stroke-dasharray="${DASHES[shape.style]}"` : ""} data-kind="${shape.kind}" data-style="${shape.style}" data-fill="${shape.fill}" data-label="${escaped(shape.label)}" data-group="${shape.group}" data-points="${of.map(points).join(";")}"/>`,
    );
  const labels = shapes
    .filter((shape) => shape.label)
    .map((shape) => {
      const [x, y] = shape.points[shape.points.length - 1]!;
      return `  <text x="${x + 1}" y="${-y}" font-family="sans-serif" font-size="${LABEL_MM}">${escaped(shape.label)}</text>`;
    });
  return [
    `<svg xmlns="http://www.w3.org/2000/svg" width="${width}mm" height="${height}mm" viewBox="${x} ${y} ${width} ${height}">`,
    patterns(0.3),
    ...paths,
    ...labels,
    "</svg>",
    "",
  ].join("\n");
}

/** Shapes of an SVG that this page wrote; null for an SVG of another program. */
export function ownShapes(text: string): Shape[] | null {
  const paths = [
    ...new DOMParser().parseFromString(text, "image/svg+xml").querySelectorAll("svg > path"),
  ] as SVGPathElement[];
  if (paths.length === 0 || paths.some((path) => !path.dataset.points)) return null;
  return paths.flatMap((path) =>
    path.dataset.points!.split(";").map((points) => ({
      kind: path.dataset.kind as Kind,
      style: (path.dataset.style ?? "solid") as Style,
      fill: (path.dataset.fill ?? (path.getAttribute("fill") === "none" ? "none" : "solid")) as Fill,
      label: path.dataset.label ?? "",
      group: Number(path.dataset.group ?? 0),
      points: points.split(" ").map((one) => one.split(",").map(Number) as Point),
    })),
  );
}

/** Shapes that the server returned, with group numbers after those of the drawing. */
export function foreignShapes(
  found: { kind: Kind; points: Point[]; group: number; style?: Style; fill?: Fill; label?: string }[],
  after: number,
): Shape[] {
  return found.map((one) => ({
    ...one,
    style: one.style ?? "solid",
    fill: one.fill ?? "none",
    label: one.label ?? "",
    group: one.group + after,
  }));
}

/** Text of a seam that sews a drawing at the drawn place: the SVG begins a margin left of and below the lowest corner. */
export function seamText(file: string, stitch_mm: number, speed: number, low: Point): string {
  const zero = low.map((at) => Number((at - MARGIN).toFixed(6)));
  return `[drawing]\nfile = ${JSON.stringify(file)}\norigin = ["${zero[0]} mm", "${zero[1]} mm"]\nby = "all"\n\n[stitching]\nstitch_length = "${stitch_mm} mm"\nneedle_speed = "${speed} stitch/s"\n`;
}

/** Radii of a mandrel from a line: x is the position along its axis, y the radius. Empty if the line is no profile. */
export function radiusText(line: Shape, axis: string, along: string): string {
  const points = [...line.points].sort((a, b) => a[0] - b[0]),
    rises = points.every((p, k) => k === 0 || p[0] > points[k - 1]![0]);
  if (line.kind !== "line" || !rises || points.some((p) => p[1] <= 0)) return "";
  return `${axis}=${points.map((p) => `${p[1]} mm at ${along} ${p[0]} mm`).join("; ")}`;
}
