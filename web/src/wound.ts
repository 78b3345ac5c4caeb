/** The bands laid so far on the mandrel of a product, read piece by piece while it is wound. */

import * as three from "three";
import type { Mandrel, State } from "./messages";
import { colour } from "./theme";
import { before } from "./wording";

/** An answer of /api/wound; m, rad and s. */
export interface Piece {
  proof: string;
  first: number;
  next: number;
  count: number;
  running: boolean;
  mandrel?: Mandrel;
  width?: number;
  fibre: {
    times_s: number[];
    along: number[];
    radius: number[];
    angle: number[];
    begins: boolean[];
    slips: boolean[];
  };
}

const ASKS_MS = 400; // between two requests in a run
const LIFT = 0.004; // of the first band over the mandrel, and of the last over the first, in radii
const EDGE = 0.6; // brightness of one edge of a band, so that one is told from the next

/** A place of the fibre in space: the eye is above, at an angle of minus the mandrel's turn. */
export function inSpace(along: number, radius: number, angle: number): [number, number, number] {
  return [along, -radius * Math.sin(angle), radius * Math.cos(angle)];
}

export class Wound {
  readonly group = new three.Group();
  mandrel: Mandrel | null = null;
  private proof = ""; // the calculation that is shown; empty without a product
  private mesh: three.Mesh<three.BufferGeometry, three.MeshLambertMaterial> | null = null;
  private times = new Float64Array(0);
  private slips = new Uint8Array(0);
  private width = 0; // m
  private last: [number, number, number] = [0, 0, 0]; // the place read last
  private filled = 0; // places that were read
  private laid = 0; // number of read places that the last run laid; all of them without a run
  private inks: three.Color[] = []; // colours of fibre that stays, and of fibre that slips
  private asking = false;
  private askedMs = 0;

  /**
   * @param ask a request to the panel
   * @param changed called when another product is shown, or more of its fibre
   */
  constructor(
    private readonly ask: (path: string) => Promise<Response>,
    private readonly changed: (other: boolean, laid: number) => void,
  ) {}

  /** Show the fibre of a calculation; "" for none. */
  show(proof: string): void {
    if (proof === this.proof) return;
    this.clear();
    this.proof = proof;
    if (proof) void this.read();
  }

  /**
   * Read on while a run lays more; show the fibre laid until a time of the plan, null for all of it. If a
   * run was broken off, the fibre read so far is the whole work.
   */
  live(state: State, until_s: number | null): void {
    const runs = state.progress !== null && state.progress.ended === null;
    if (this.mandrel && runs && performance.now() - this.askedMs > ASKS_MS) void this.read();
    const times = this.times.subarray(0, this.filled);
    const laid = until_s === null ? this.filled : before(times, until_s) + 1;
    if (this.mandrel && laid !== this.laid) {
      this.laid = laid;
      this.changed(false, laid);
    }
    this.upTo(this.laid);
  }

  /** Show what is laid at a time of the plan. */
  at(time_s: number): void {
    if (!this.mandrel) return;
    if (this.filled < this.times.length && performance.now() - this.askedMs > ASKS_MS) void this.read();
    this.upTo(before(this.times.subarray(0, this.filled), time_s) + 1);
  }

  /** Take the colours of the theme. */
  recolour(): void {
    this.inks = [new three.Color(colour("--done")), new three.Color(colour("--measured"))];
    const found = this.mesh?.geometry.getAttribute("color");
    if (!found) return;
    for (let k = 0; k < this.filled; k++) this.paint(k);
    found.needsUpdate = true;
  }

  private async read(): Promise<void> {
    if (this.asking) return;
    [this.asking, this.askedMs] = [true, performance.now()];
    const { proof } = this;
    const words = new URLSearchParams({ proof, after: String(this.filled) });
    try {
      const answer = await this.ask(`/api/wound?${words}`);
      const piece = answer.ok ? ((await answer.json()) as Piece) : null;
      if (piece && piece.proof === proof && this.proof === proof) this.take(piece);
    } catch {
      // the panel is gone: the next state says so
    } finally {
      this.asking = false;
    }
    if (this.proof && this.proof !== proof) await this.read(); // another calculation came meanwhile
  }

  private take(piece: Piece): void {
    const other = piece.mandrel !== undefined && this.mandrel === null;
    if (piece.first === 0 && piece.mandrel) {
      if (other) this.begin(piece.mandrel, piece.width ?? 0, piece.count);
      this.filled = 0;
    }
    if (!this.mesh || piece.first !== this.filled) return;
    for (let k = piece.first; k < piece.next; k++) this.lay(k, piece);
    this.filled = this.laid = piece.next;
    const { attributes, index } = this.mesh.geometry;
    for (const one of [...Object.values(attributes), index!] as three.BufferAttribute[]) {
      one.addUpdateRange(6 * piece.first, 6 * (piece.next - piece.first)); // 6 numbers of each for a place
      one.needsUpdate = true;
    }
    this.changed(other, this.laid);
  }

  /** Make room for all places at once: it is not grown, and another calculation has its own. */
  private begin(mandrel: Mandrel, width: number, count: number): void {
    [this.mandrel, this.width] = [mandrel, width];
    this.times = new Float64Array(count);
    this.slips = new Uint8Array(count);
    const geometry = new three.BufferGeometry();
    for (const name of ["position", "normal", "color"])
      geometry.setAttribute(name, new three.BufferAttribute(new Float32Array(6 * count), 3));
    geometry.setIndex(new three.BufferAttribute(new Uint32Array(6 * count), 1));
    const material = new three.MeshLambertMaterial({ vertexColors: true, side: three.DoubleSide });
    this.mesh = new three.Mesh(geometry, material);
    this.mesh.frustumCulled = false; // its size is not known before it is wound
    this.group.add(this.mesh);
  }

  private clear(): void {
    this.group.clear();
    this.mesh?.geometry.dispose();
    this.mesh?.material.dispose();
    [this.mesh, this.mandrel, this.filled, this.laid] = [null, null, 0, 0];
    [this.times, this.slips] = [new Float64Array(0), new Uint8Array(0)];
  }

  /** Lay one place: two corners across the band, and two triangles from the place before. */
  private lay(k: number, { fibre, first }: Piece): void {
    const j = k - first;
    const [along, radius, angle] = [fibre.along[j]!, fibre.radius[j]!, fibre.angle[j]!];
    this.times[k] = fibre.times_s[j]!;
    this.slips[k] = fibre.slips[j] ? 1 : 0;
    const here = inSpace(along, radius, angle);
    const begins = fibre.begins[j]! || k === 0;
    const next = fibre.along[j + 1];
    const there: [number, number, number] =
      begins && next !== undefined ? inSpace(next, fibre.radius[j + 1]!, fibre.angle[j + 1]!) : this.last;
    const way = new three.Vector3(...here).sub(new three.Vector3(...there)).multiplyScalar(begins ? -1 : 1);
    const [out, back] = this.slope(along);
    const normal = new three.Vector3(back, -out * Math.sin(angle), out * Math.cos(angle));
    const across = way.clone().cross(normal).normalize();
    const most = Math.max(...this.mandrel!.radius);
    const middle = new three.Vector3(...here).addScaledVector(
      normal,
      LIFT * most * (1 + k / Math.max(this.times.length, 1)),
    );
    const { attributes, index } = this.mesh!.geometry;
    for (const side of [0, 1]) {
      const corner = middle.clone().addScaledVector(across, (side - 0.5) * this.width);
      attributes.position!.setXYZ(2 * k + side, corner.x, corner.y, corner.z);
      attributes.normal!.setXYZ(2 * k + side, normal.x, normal.y, normal.z);
    }
    const from = begins ? 2 * k : 2 * k - 2; // the first place of a fibre has no place before it
    [from, from + 1, 2 * k, 2 * k, from + 1, 2 * k + 1].forEach((corner, n) => {
      index!.setX(6 * k + n, corner);
    });
    this.paint(k);
    this.last = here;
  }

  private paint(k: number): void {
    const found = this.inks[this.slips[k]!]!;
    const stored = this.mesh!.geometry.attributes.color!;
    for (const side of [0, 1]) {
      const share = side || this.slips[k] ? 1 : EDGE;
      stored.setXYZ(2 * k + side, found.r * share, found.g * share, found.b * share);
    }
  }

  /** Outward part and part along the axis of the surface's normal at a place. */
  private slope(along: number): [number, number] {
    const { at, radius } = this.mandrel!;
    const k = Math.min(Math.max(before(at, along), 0), at.length - 2);
    const [dx, dr] = [at[k + 1]! - at[k]!, radius[k + 1]! - radius[k]!];
    const size = Math.hypot(dx, dr) || 1;
    return [dx / size, -dr / size];
  }

  private upTo(places: number): void {
    this.mesh?.geometry.setDrawRange(0, 6 * places);
  }
}
