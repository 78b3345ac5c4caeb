/** A small picture of a run for the table: its way from above, or its first axis over the time. */

const SVG = "http://www.w3.org/2000/svg";
const [WIDE, TALL, EDGE] = [96, 32, 2];
const MOST = 160; // points

/** Curves of a stored run. */
export interface Trace {
  times_s: number[];
  axes: Record<string, { commanded: number[]; actual: number[]; measured: boolean }>;
}

/** The points of a picture, "x,y x,y", and what it shows. */
export function pictured(trace: Trace): { points: string; label: string } | null {
  const { X, Y } = trace.axes;
  const moving = (one: { actual: number[] } | undefined) =>
    !!one && one.actual.length > 1 && Math.max(...one.actual) > Math.min(...one.actual);
  if (moving(X) && moving(Y))
    return { points: fitted(X!.actual, Y!.actual, true), label: "its way in X and Y" };
  const [name, axis] = Object.entries(trace.axes).find(([, one]) => moving(one)) ?? [];
  if (!axis) return null;
  const first = moving(X) ? X! : axis;
  return {
    points: fitted(trace.times_s, first.actual, false),
    label: `${first === X ? "X" : name} over the time`,
  };
}

/** Points in the picture: as large as it has room for; of one scale, or each way of its own. */
function fitted(across: number[], up: number[], alike: boolean): string {
  const every = Math.max(1, Math.ceil(across.length / MOST));
  const kept = [...across.keys()].filter((k) => k % every === 0 || k === across.length - 1);
  const range = (all: number[]) => [Math.min(...all), Math.max(...all)] as [number, number];
  const [[left, right], [low, high]] = [range(across), range(up)];
  const scale = [(WIDE - 2 * EDGE) / (right - left || 1), (TALL - 2 * EDGE) / (high - low || 1)];
  const [sx, sy] = alike ? [Math.min(...scale), Math.min(...scale)] : (scale as [number, number]);
  const [x0, y0] = [(WIDE - (right - left) * sx) / 2, (TALL + (high - low) * sy) / 2];
  const point = (k: number) =>
    `${(x0 + (across[k]! - left) * sx).toFixed(1)},${(y0 - (up[k]! - low) * sy).toFixed(1)}`;
  return kept.map(point).join(" ");
}

/** The picture as an element; an empty place of its size before it is there. */
export function pictureOf(found: { points: string; label: string } | null | undefined): SVGElement {
  const svg = document.createElementNS(SVG, "svg");
  svg.setAttribute("viewBox", `0 0 ${WIDE} ${TALL}`);
  svg.setAttribute("class", "thumb");
  if (!found) {
    svg.setAttribute("aria-hidden", "true");
    return svg;
  }
  svg.setAttribute("role", "img");
  svg.setAttribute("aria-label", found.label);
  const line = document.createElementNS(SVG, "polyline");
  line.setAttribute("points", found.points);
  svg.append(line);
  return svg;
}
