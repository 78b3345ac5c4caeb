/** Mandrel or bed and path in three dimensions: planned, simulated, live. */

import * as three from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { sewnUntil } from "./cloth";
import { by, made, value } from "./dom";
import type { Mandrel, State } from "./messages";
import { Path3d } from "./path3d";
import type { Picture, Shown } from "./picture";
import { colour, onTheme } from "./theme";
import { bySoftware, onScreen, sizeOf } from "./visibility";
import { before } from "./wording";
import { inSpace, Wound } from "./wound";

type At = Record<string, number>;

const TURN_RAD = 0.05; // turn of a mandrel between two drawn points of a move

/** Places of moves with others between them, so that none turns the mandrel far. */
export function roundly(ways: At[], turns: string): At[] {
  return ways.flatMap((to, k) => {
    const from = ways[k - 1] ?? to;
    const steps = Math.max(Math.ceil(Math.abs((to[turns] ?? 0) - (from[turns] ?? 0)) / TURN_RAD), 1);
    return Array.from({ length: steps }, (_, n) => {
      const share = (n + 1) / steps;
      const names = Object.entries(to);
      return Object.fromEntries(
        names.map(([name, at]) => [name, at * share + (from[name] ?? at) * (1 - share)]),
      );
    });
  });
}

export class View3d implements Picture {
  readonly element = made("div");
  readonly turns = true;
  private readonly renderer: three.WebGLRenderer;
  private readonly scene = new three.Scene();
  private readonly camera = new three.PerspectiveCamera(35, 1.6, 0.001, 100);
  private readonly controls: OrbitControls;
  private readonly product = new three.Group(); // turns with the mandrel
  private readonly head = new three.Mesh(new three.ConeGeometry(1, 3, 16), new three.MeshLambertMaterial());
  private readonly path: Path3d; // as planned
  private readonly done: Path3d; // its first part
  private job: Shown | null = null;
  private bare: Mandrel | null = null; // of the machine or its job
  private mandrel: Mandrel | null = null; // the shown one: a product's own mandrel, if there is one
  private size = 0.1; // m
  private dirty = true;
  private shown = ""; // the state last drawn
  private readonly seen: () => boolean;
  /** Whether the processor draws: then without smoothed edges, and fewer frames. */
  readonly slow = bySoftware();

  /** The bands of a product on its mandrel. */
  private readonly wound: Wound;

  /**
   * @param ask a request to the panel
   * @param told called when the legend changes
   */
  constructor(ask: (path: string) => Promise<Response>, told: () => void) {
    this.wound = new Wound(ask, (other, laid) => {
      this.shown = "";
      this.element.dataset.laid = String(laid);
      if (!other) return;
      this.show(this.job, this.bare);
      told();
    });
    this.renderer = new three.WebGLRenderer({ antialias: !this.slow, alpha: !this.slow });
    [this.path, this.done] = [1.5, 4].map((wide) => new Path3d(this.slow ? 0 : wide)) as [Path3d, Path3d];
    this.element.append(this.renderer.domElement);
    this.camera.up.set(0, 0, 1);
    this.controls = new OrbitControls(this.camera, this.renderer.domElement);
    this.controls.addEventListener("change", () => {
      this.dirty = true;
    });
    const lamp = new three.DirectionalLight(0xffffff, 1.6);
    lamp.position.set(-1, -2, 3);
    this.scene.add(new three.AmbientLight(0xffffff, 1.4), lamp, this.product, this.head);
    by<HTMLSelectElement>("seen-from").onchange = () => this.look();
    this.seen = onScreen(this.element);
    onTheme(() => this.show(this.job, this.bare));
  }

  readonly zoom = (factor: number): void => {
    if (factor === 0) this.look();
    const { target } = this.controls;
    const from = this.camera.position.clone().sub(target);
    this.camera.position.copy(target).addScaledVector(from, 1 / (factor || 1));
    this.controls.update();
    this.dirty = true;
  };

  /** Show the path of a job; without one the bare machine. */
  show(job: Shown | null, mandrel: Mandrel | null): void {
    this.job = job;
    this.bare = mandrel;
    this.wound.show(job?.proof ?? "");
    this.wound.recolour();
    this.mandrel = this.wound.mandrel ?? mandrel;
    this.head.material.color.set(colour("--ink"));
    // A transparent picture is drawn twice: without a graphics card the picture has an opaque ground.
    if (this.slow) this.renderer.setClearColor(colour("--card"));
    this.shown = "";
    this.product.clear();
    const count = Object.values(job?.planned ?? {})[0]?.length ?? 0;
    // The laid fibre is shown instead of the path of the eye.
    const ways = this.wound.mandrel ? [] : Array.from({ length: count }, (_, k) => this.planned(k));
    const turns = mandrel?.axis ?? "";
    // Before the calculation a move is one straight way, which would cut through the mandrel.
    const points = (job?.times_s.length ? ways : roundly(ways, turns)).map((at) => this.onProduct(at));
    const box = new three.Box3().setFromPoints(
      points.length ? points : [new three.Vector3(-0.1, -0.1, 0), new three.Vector3(0.1, 0.1, 0)],
    );
    if (this.wound.mandrel) this.product.add(...this.onShaft(this.wound.mandrel), this.wound.group);
    else if (mandrel) this.product.add(this.body(mandrel, box));
    else this.product.add(this.bed(box));
    this.path.through(points, colour("--faint"));
    this.done.through(points, colour("--accent"));
    if (points.length) {
      const { object } = this.done; // above the planned path
      object.position.set(0, 0, mandrel ? 0 : this.size / 500);
      object.scale.set(1, ...((mandrel ? [1.004, 1.004] : [1, 1]) as [number, number]));
      this.product.add(this.path.object, object);
    }
    this.size = Math.max(
      box.getSize(new three.Vector3()).length(),
      this.mandrel ? 2 * Math.max(...this.mandrel.radius) : 0,
      0.01,
    );
    this.head.scale.setScalar(this.size / 60);
    this.look();
    this.put(count ? this.planned(0) : {}, 0);
  }

  live(state: State): void {
    const at: At = {};
    for (const [name, where] of Object.entries(state.axes))
      at[name] = where.measured ?? where.load ?? where.commanded ?? 0;
    const run = state.progress?.ended === null ? state.progress : null; // the run's time does not advance in a hold
    this.wound.live(state, sewnUntil(state.progress, this.job));
    this.put(at, run ? this.step(run.time_s) : 0);
  }

  at(time_s: number): void {
    const k = this.step(time_s);
    this.wound.at(time_s);
    this.put(this.planned(k), k + 1);
  }

  legend(): [string, string][] {
    const path: [string, string][] = [
      ["var(--faint)", "planned path"],
      ["var(--accent)", "done so far"],
    ];
    const fibre: [string, string][] = [
      ["var(--done)", "fibre laid so far (before a run: all of it)"],
      ["var(--measured)", "fibre that slips"],
    ];
    return this.wound.mandrel ? fibre : this.job ? path : [];
  }

  private planned(k: number): At {
    const at: At = {};
    for (const [name, places] of Object.entries(this.job?.planned ?? {})) at[name] = places[k] ?? 0;
    return at;
  }

  /** Index of the planned point at a time. */
  private step(time_s: number): number {
    return Math.max(before(this.job?.times_s ?? [], time_s), 0);
  }

  private radius(along: number): number {
    const { at, radius } = this.mandrel!;
    const next = at.findIndex((place) => place > along);
    if (next <= 0) return next === 0 ? radius[0]! : radius[radius.length - 1]!;
    const share = (along - at[next - 1]!) / (at[next]! - at[next - 1]!);
    return radius[next - 1]! + share * (radius[next]! - radius[next - 1]!);
  }

  private onProduct(at: At): three.Vector3 {
    if (!this.mandrel) return new three.Vector3(at.X ?? 0, at.Y ?? 0, at.Z ?? 0);
    const along = at[this.mandrel.along] ?? 0,
      turn = at[this.mandrel.axis] ?? 0,
      radius = this.radius(along) * 1.002;
    return new three.Vector3(...inSpace(along, radius, -turn)); // under the eye at that turn
  }

  private body(mandrel: Mandrel, box: three.Box3): three.Object3D {
    const low = Math.min(box.min.x, mandrel.at[0] ?? 0) - 0.02,
      high = Math.max(box.max.x, mandrel.at[mandrel.at.length - 1] ?? 0) + 0.02;
    const places = [low, ...mandrel.at.filter((place) => place > low && place < high), high];
    return this.turned(
      places.map((place) => [this.radius(place), place]),
      colour("--line"),
    );
  }

  /** The mandrel of a product on a shaft that is as thick as half of its ends. */
  private onShaft({ at, radius }: Mandrel): three.Object3D[] {
    const [low, high] = [at[0]!, at[at.length - 1]!];
    const beyond = (high - low) / 6;
    const thin = Math.max(Math.min(radius[0]!, radius[radius.length - 1]!) / 2, this.size / 100);
    return [
      this.turned(
        at.map((place, k) => [radius[k]!, place]),
        colour("--line"),
      ),
      this.turned(
        [
          [0, low - beyond],
          [thin, low - beyond],
          [thin, high + beyond],
          [0, high + beyond],
        ],
        colour("--edge"),
      ),
    ];
  }

  /** A body that a profile of radius and place sweeps round the axis. */
  private turned(profile: [number, number][], ink: string): three.Object3D {
    const found = new three.Mesh(
      new three.LatheGeometry(
        profile.map(([radius, place]) => new three.Vector2(radius, place)),
        48,
      ),
      new three.MeshLambertMaterial({ color: ink, side: three.DoubleSide }),
    );
    found.rotation.z = -Math.PI / 2; // from y, the axis of a lathe geometry, to x
    return found;
  }

  private bed(box: three.Box3): three.Object3D {
    const size = box.getSize(new three.Vector3()),
      middle = box.getCenter(new three.Vector3());
    const side = Math.max(size.x, size.y, 0.01) * 1.2,
      found = new three.GridHelper(side, 12, colour("--edge"), colour("--line"));
    found.rotation.x = Math.PI / 2;
    found.position.set(middle.x, middle.y, Math.min(box.min.z, 0));
    return found;
  }

  private look(): void {
    const from: Record<string, [number, number, number]> = {
      front: [0, -1, 0.05],
      above: [0, -0.02, 1],
      corner: [-0.55, -0.9, 0.6],
    };
    const ball = new three.Box3().setFromObject(this.product).getBoundingSphere(new three.Sphere());
    const half = Math.atan(Math.tan((this.camera.fov * Math.PI) / 360) * Math.min(this.camera.aspect, 1));
    const way = new three.Vector3(...(from[value("seen-from")] ?? from.corner!)).normalize();
    this.controls.target.copy(ball.center);
    this.camera.position.copy(ball.center).addScaledVector(way, (0.85 * ball.radius) / Math.sin(half));
    this.controls.update();
    this.dirty = true;
  }

  /** Turn the product, place the head, and mark the first points of the path as done. */
  private put(at: At, points: number): void {
    const shown = this.inPixels(at, points);
    if (shown === this.shown) return; // nothing is drawn again where no pixel would change
    this.shown = shown;
    if (this.mandrel) {
      const along = at[this.mandrel.along] ?? 0;
      this.product.rotation.x = at[this.mandrel.axis] ?? 0;
      const radius = this.wound.mandrel ? Math.max(...this.mandrel.radius) : this.radius(along);
      this.head.position.set(along, 0, radius + this.size / 20);
    } else this.head.position.copy(this.onProduct(at)).add(new three.Vector3(0, 0, this.size / 40));
    this.head.rotation.x = -Math.PI / 2;
    this.done.upTo(points);
    this.dirty = true;
  }

  /** What is drawn, in steps of half a pixel: an encoder at rest changes its last digits. */
  private inPixels(at: At, points: number): string {
    const far = this.camera.position.distanceTo(this.controls.target);
    const tall = 2 * far * Math.tan((this.camera.fov * Math.PI) / 360);
    const pixel = tall / Math.max(this.renderer.domElement.height, 1);
    const steps = Object.entries(at).map(([name, place]) => {
      const turns = this.mandrel?.axis === name;
      const radius = turns ? Math.max(...this.mandrel!.radius) : 1;
      return Math.round((2 * place * radius) / pixel);
    });
    return JSON.stringify([steps, points]);
  }

  resize(): void {
    const [width, height] = sizeOf(this.element);
    this.renderer.setSize(width, height);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.dirty = true;
  }

  draw(): void {
    if (!this.dirty || !this.seen()) return;
    this.dirty = false;
    this.renderer.render(this.scene, this.camera);
    const place = by("space");
    place.dataset.drawn = String(Number(place.dataset.drawn ?? 0) + 1);
  }
}
